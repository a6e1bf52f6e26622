"""The proof that moteus controllers switch torque off by themselves, in a computed time."""

from collections.abc import Iterator
from math import nan

import pytest

from stepgap.hardware.bus_rig import HostTime
from stepgap.hardware.commissioning.check import Check, Timing, with_watchdog
from stepgap.hardware.hopper.moteus import MoteusSettings
from stepgap.hardware.moteus.can_bus import CanBus, stream_of
from stepgap.hardware.moteus.moteus_rig import MoteusRig
from stepgap.hardware.moteus.watchdog import check_timeout
from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper.parameters import RobotParameters
from tests.hardware.ethercat.ring_process import Recorder
from tests.hardware.moteus.emulated_moteus import (
    DAMPING,
    FAULT,
    FAULTED,
    MODE,
    TIMED_OUT,
    TIMEOUT,
    TORQUE,
    Controllers,
    emulated,
)
from tests.hardware.moteus.test_moteus_rig import fresh

TIMEOUT_MODE, DEFAULT_TIMEOUT = "servo.timeout_mode", "servo.default_timeout_s"


class Passing:
    """A time that passes only while the rig waits."""

    def __init__(self) -> None:
        self.time = 0.0

    @property
    def host(self) -> HostTime:
        return HostTime(lambda: self.time, self.pause)

    def pause(self, duration: float) -> None:
        self.time += duration


def rig_of(settings: MoteusSettings, passing: Passing) -> MoteusRig:
    return MoteusRig(settings, settings.sensor_model(RobotParameters().boom_length), passing.host)


@pytest.fixture
def bench() -> Iterator[tuple[Controllers, MoteusRig]]:
    settings, passing = fresh(), Passing()
    with emulated(settings, Recorder(), lambda: passing.time) as controllers:
        rig = rig_of(settings, passing)
        yield controllers, rig
        rig.close()


def test_the_time_until_the_controllers_give_no_torque_is_measured(bench: tuple[Controllers, MoteusRig]) -> None:
    """Queries every millisecond do not restart the watchdog; it ends the mode 0.5 s after the last command."""
    controllers, rig = bench
    rig.connect()
    for _ in range(3):
        rig.read()
        rig.write((3.0, -3.0))
    found = rig.watchdog_times()
    assert found.setting == 0.5
    assert found.measured == {f"controller {number}": pytest.approx(0.5, abs=1.1e-3) for number in (1, 2)}
    assert controllers.modes() == [TIMED_OUT, TIMED_OUT]
    assert controllers.torques[-1] == (0.0, 0.0), "the last command has no torque"
    rig.write((1.0, 1.0))
    with pytest.raises(RigFault, match="mode timeout"):
        rig.read()


def test_the_check_of_a_robot_contains_it() -> None:
    settings, passing = fresh(), Passing()
    good = Check(1e-3, 2, False, Timing(5000, 0.0, 0.0, 0.0, 0.0, 1.0, 0, 0), 0, "", "")
    with emulated(settings, Recorder(), lambda: passing.time) as controllers:
        passed = with_watchdog(good, lambda: rig_of(settings, passing))
        controllers.controllers[2].has_watchdog = False
        failed = with_watchdog(good, lambda: rig_of(settings, passing))
    assert (passed.failures(), passed.remarks) == ([], ())
    assert passed.watchdog is not None
    (failure,) = failed.failures()
    assert failure == ("controller 2 accepts torque 1.10 s after the last command: its watchdog of 0.5 s is not proven")


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ({TIMEOUT: 0.1}, "controller 1 has a watchdog of 0.1 s, but the settings have 0.5"),
        ({TIMEOUT: nan}, "controller 1 has a watchdog of nan s, but the settings have 0.5"),
        ({TORQUE: 0.5}, "controller 1 gives 0.5 N·m in mode timeout 1.10 s after the last command"),
        ({MODE: FAULTED, FAULT: 33}, r"controller 1 went to mode 1 \(fault 33\) while its watchdog was measured"),
        ({MODE: 0}, r"controller 1 went to mode 0 \(fault 0\) while its watchdog was measured"),
    ],
    ids=["another time", "no time", "torque", "fault", "stopped"],
)
def test_what_proves_no_watchdog_is_a_fault(
    bench: tuple[Controllers, MoteusRig], override: dict[int, float], expected: str
) -> None:
    controllers, rig = bench
    rig.connect()
    rig.write((0.0, 0.0))
    rig.read()
    controllers.settle().overrides = override
    with pytest.raises(RigFault, match=expected) as caught:
        rig.watchdog_times()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        (
            str(DAMPING),
            r"servo\.timeout_mode is 12 \(damping\), so its motor has torque after its watchdog; in `tview`",
        ),
        ("15", r"servo\.timeout_mode is 15 \(brake\)"),
        ("7", r"servo\.timeout_mode is 7 \(unknown\)"),
        ("text", r"reports 'text' as its servo\.timeout_mode, which is not a number"),
    ],
)
def test_a_controller_with_torque_after_a_timeout_is_refused(
    bench: tuple[Controllers, MoteusRig], mode: str, expected: str
) -> None:
    """At rest, damping gives no torque either, so that only the configuration tells the difference."""
    controllers, rig = bench
    controllers.controllers[2].config[TIMEOUT_MODE] = mode
    with pytest.raises(RigFault, match=f"controller 2:? {expected}"):
        rig.connect()
    assert controllers.modes() == [0, 0]


@pytest.mark.parametrize(
    ("default", "remarks"), [("0.1", 0), ("0.5", 0), ("0.6", 1), ("nan", 1)], ids=["short", "0.5", "long", "none"]
)
def test_a_long_default_timeout_is_a_remark(bench: tuple[Controllers, MoteusRig], default: str, remarks: int) -> None:
    controllers, rig = bench
    controllers.controllers[1].config[DEFAULT_TIMEOUT] = default
    rig.connect()
    assert len(rig.remarks) == remarks
    assert all(f"controller 1: servo.default_timeout_s is {default}" in remark for remark in rig.remarks)


def test_older_text_of_a_controller_is_discarded(bench: tuple[Controllers, MoteusRig]) -> None:
    controllers, rig = bench
    controllers.controllers[1].text = b"12\r\n" * 50
    rig.connect()


def test_voltage_and_temperature_are_logged(bench: tuple[Controllers, MoteusRig]) -> None:
    _, rig = bench
    rig.connect()
    logged = dict(zip(rig.diagnostic_units, rig.diagnostics, strict=True))
    assert logged == {
        "motor_1_bus_voltage": 24.0,
        "motor_1_temperature": 31.0,
        "motor_2_bus_voltage": 24.0,
        "motor_2_temperature": 31.0,
    }
    assert set(rig.diagnostic_units.values()) == {"V", "°C"}


@pytest.mark.parametrize(
    "data", [b"", b"\x50", b"\x41", b"\x41\x01\x05ab", bytes([0x21, 0x00, 0x0A]), b"\x40\x01\x01a"]
)
def test_frames_without_text_are_ignored(data: bytes) -> None:
    assert not stream_of(data)


def test_a_controller_that_reports_nothing_is_refused(bench: tuple[Controllers, MoteusRig]) -> None:
    empty = CanBus("virtual", "a bus without controllers")
    with pytest.raises(RigFault, match=r"controller 1 did not report its servo\.timeout_mode"):
        check_timeout(empty, bench[1]._controllers[1], 1e-3)
    empty.close()
