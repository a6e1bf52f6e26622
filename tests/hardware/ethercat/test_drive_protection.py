"""Temperature, bus voltage, STO and enable inputs on the emulated ring, in lock-step."""

from dataclasses import replace
from functools import cache
from math import inf

import numpy as np
import pytest

from stepgap.hardware.ethercat import ethercat_rig
from stepgap.hardware.ethercat.drive_watch import BEYOND, MOST_DOUBTS, NO_STO_INPUT
from stepgap.hardware.ethercat.emulator.drive import DC_LINK_VOLTAGE, DRIVE_INPUTS, DRIVE_TEMPERATURE
from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.ethercat.ethercat_rig import EthercatRig
from stepgap.hardware.hopper.ethercat import RigSettings
from stepgap.hardware.hopper.ring_rig import emulated_settings
from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from tests.hardware.ethercat.ring_process import INTERFACE, live_ring
from tests.hardware.ethercat.test_ethercat_rig import SETTINGS as WITHOUT_VALUES
from tests.hardware.ethercat.test_ethercat_rig import rig_of, ticks_until_fault

pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")

LAYOUT = Twin(RobotParameters(), RealityGap(), np.random.default_rng(0)).sensor_model
SETTINGS = emulated_settings(LAYOUT, RobotParameters(), RingSettings(inputs_after_tick=True), INTERFACE)
BEFORE = 10
"""Number of ticks before a fault."""


@cache
def cycles_to_connect() -> int:
    """Number of frames with outputs that a bring-up takes."""
    with live_ring() as ring, rig_of(SETTINGS):
        return ring.look().cycles


def at(fault: Fault) -> Fault:
    """The fault some ticks after the bring-up."""
    return fault.at(cycles_to_connect() + BEFORE)


def seen(rig: EthercatRig) -> dict[str, float]:
    return dict(zip(rig.diagnostic_units, rig.diagnostics, strict=True))


STOPPED: dict[str, tuple[Fault, int, str, dict[str, float]]] = {
    "STO": (Fault("opened input", 0, "drive_2"), 1, "the STO input of slave 2 'drive_2' is open", {"motor_2_sto": 1.0}),
    "one channel of STO": (
        Fault("opened input", 0, "drive_1", bits=0x2_0000),
        1,
        "the STO input of slave 1 'drive_1' is open",
        {"motor_1_sto": 1.0, "motor_2_sto": 0.0},
    ),
    "enable": (
        Fault("opened input", 0, "drive_1", bits=0x4_0000),
        1,
        "the enable input of slave 1 'drive_1' is open",
        {"motor_1_enable": 1.0},
    ),
    # 25 to 90 °C at 2 K a tick
    "temperature": (
        Fault("heated", 0, "drive_1", rate=2000.0),
        33 + BEYOND,
        "slave 1 'drive_1': its temperature is 9",
        {},
    ),
    # 480 J charge 0.5 F from 48 to 65 V
    "overvoltage": (
        Fault("fed bus", 0, "drive_2", power=50_000.0),
        10 + BEYOND,
        "slave 2 'drive_2': its bus voltage is 6",
        {},
    ),
    "a voltage of zero": (
        Fault("stuck object", 0, "drive_1", index=DC_LINK_VOLTAGE, value=0),
        BEYOND,
        "slave 1 'drive_1': its bus voltage is 0.0 V, allowed is 30 to 65",
        {"motor_1_bus_voltage": 0.0},
    ),
}


@pytest.mark.parametrize("name", STOPPED)
def test_torque_goes_off_with_its_reason(name: str) -> None:
    fault, most, expected, logged = STOPPED[name]
    with live_ring(at(fault)) as ring, rig_of(SETTINGS) as rig:
        ticks, message = ticks_until_fault(rig, 200)
        assert BEFORE <= ticks <= BEFORE + most
        assert expected in message
        assert "\n" not in message
        assert seen(rig).items() >= logged.items()
        behind = ring.look()
        assert behind.now == [0.0, 0.0]
        assert behind.enabled == [False, False]
        with pytest.raises(RigFault, match="start again"):
            rig.connect()


WARNED: dict[str, tuple[Fault, int, str]] = {
    "heat": (Fault("heated", 0, "drive_2", rate=1000.0), 55 + BEYOND, "slave 2 'drive_2': its temperature is 8"),
    "no temperature": (
        Fault("stuck object", 0, "drive_1", index=DRIVE_TEMPERATURE, value=-0x8000),
        MOST_DOUBTS,
        "its temperature is not plausible",
    ),
    "frozen voltage": (
        Fault("stuck object", 0, "drive_2", index=DC_LINK_VOLTAGE),
        100,
        "slave 2 'drive_2': its bus voltage is frozen at 4",
    ),
}


@pytest.mark.parametrize("name", WARNED)
def test_the_robot_is_warned_before_torque_goes_off(name: str) -> None:
    fault, most, expected = WARNED[name]
    settings = SETTINGS
    if "frozen" in name:
        settings = replace(SETTINGS, motor_2=replace(SETTINGS.motor_2, bus_voltage_frozen_time=0.1))
    faults = [at(fault)] if "frozen" not in name else [at(Fault("fed bus", 0, "drive_2", power=1.0)), at(fault)]
    with live_ring(*faults) as ring, rig_of(settings) as rig:
        tick = 0
        for tick in range(BEFORE + most + 1):
            assert rig.warning == "", tick
            assert ticks_until_fault(rig, 1) == (1, "")
            if rig.warning:
                break
        assert expected in rig.warning
        assert BEFORE + most - 3 <= tick <= BEFORE + most
        assert "\n" not in rig.warning
        assert ring.look().enabled == [True, True]


@pytest.mark.parametrize(
    ("faults", "settings", "expected"),
    [
        (
            [Fault("opened input", 0, "drive_1", code=0xFF20), Fault("trip", 1, "drive_2")],
            SETTINGS,
            "the STO input of slave 1 'drive_1' is open, so that the drives get no torque: slave 1 'drive_1' is in",
        ),
        ([Fault("opened input", 0, "drive_2")], WITHOUT_VALUES, NO_STO_INPUT),
        (
            [],  # closed, but of the other polarity according to the settings
            replace(SETTINGS, motor_2=replace(SETTINGS.motor_2, sto_open=1)),
            "the STO input of slave 2 'drive_2' is open, so that the drives get no torque",
        ),
    ],
)
def test_connecting_with_an_open_input_is_refused(
    faults: list[Fault], settings: RigSettings, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ethercat_rig, "STATE_TIMEOUT", 0.2)
    with live_ring(*faults) as ring:
        with pytest.raises(RigFault) as caught:
            rig_of(settings).connect()
        assert ring.look().enabled[1] is False
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_values_are_read_with_their_units_and_limits_and_healthy_drives_run_on() -> None:
    with live_ring() as ring, rig_of(SETTINGS) as rig:
        assert ticks_until_fault(rig, 100) == (100, "")
        assert rig.warning == ""
        assert rig.remarks == ()
        values = seen(rig)
        assert values["motor_1_temperature"] == pytest.approx(25.0, abs=0.2)
        assert 48.0 <= values["motor_2_bus_voltage"] < 55.0, "its motor is driven"
        assert values["motor_1_digital_inputs"] == 0x7_0000
        assert rig.diagnostic_ranges["motor_2_bus_voltage"] == (30.0, 65.0)
        assert rig.diagnostic_names["motor_1_sto"] == {0: "closed", 1: "open"}
        assert ring.look().enabled == [True, True]


def test_values_without_limits_give_remarks() -> None:
    none = {"temperature_warning": inf, "temperature_limit": inf, "bus_voltage": (), "sto_bits": (), "enable_bits": ()}
    motors = {name: replace(getattr(SETTINGS, name), **none) for name in ("motor_1", "motor_2")}
    with (
        live_ring(Fault("stuck object", 0, "drive_1", index=DRIVE_INPUTS, value=0)),
        rig_of(replace(SETTINGS, **motors)) as rig,
    ):
        assert ticks_until_fault(rig, 20) == (20, "")
        assert rig.remarks[0] == NO_STO_INPUT
        assert len(rig.remarks) == 7
        assert "slave 2 'drive_2' reports temperature, but temperature_limit is not set" in rig.remarks
