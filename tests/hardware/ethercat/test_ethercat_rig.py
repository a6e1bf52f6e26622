"""The rig on the emulated ring: refused settings, readings and torques, and reactions to faults."""

from dataclasses import replace
from functools import cache
from math import inf, nan

import pytest

from stepgap.hardware.ethercat.emulator.drive import ELMO_GOLD
from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.hardware.ethercat.emulator.terminals import ANALOG_IDENTITY, COUPLER_IDENTITY, ENCODER_IDENTITY
from stepgap.hardware.ethercat.ethercat_rig import EthercatRig
from stepgap.hardware.ethercat.rig_settings import Encoder, Motor, Slave
from stepgap.hardware.hopper.ethercat import Contact, RigSettings, hopper_on_ethercat
from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.tick.limits import SafetyLimits
from tests.hardware.ethercat.ring_process import INTERFACE, live_ring

pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")

PDOS = {ELMO_GOLD: "elmo-cst", COUPLER_IDENTITY: "none", ENCODER_IDENTITY: "beckhoff-el5151"}
IDENTITIES = {
    "drive_1": ELMO_GOLD,
    "drive_2": ELMO_GOLD,
    "coupler": COUPLER_IDENTITY,
    "boom_horizontal": ENCODER_IDENTITY,
    "boom_vertical": ENCODER_IDENTITY,
    "contact_force": ANALOG_IDENTITY,
}
SETTINGS = RigSettings(
    interface=INTERFACE,
    pivot_height=0.4,
    slaves=tuple(
        Slave(name=name, vendor=who.vendor, product=who.product, pdos=PDOS.get(who, "analog-input"))
        for name, who in IDENTITIES.items()
    ),
    motor_1=Motor(slave="drive_1", counts_per_turn=16384, zero=100, rated_torque=16, torque_limit=20),
    motor_2=Motor(slave="drive_2", counts_per_turn=16384, sign=-1, rated_torque=16, torque_limit=20),
    boom_horizontal=Encoder(slave="boom_horizontal", counts_per_turn=5000),
    boom_vertical=Encoder(slave="boom_vertical", counts_per_turn=16384),
    contact=Contact(slave="contact_force", newton_per_count=0.1, touchdown_force=5),
    limits=SafetyLimits(torque=20.0),
    reply_timeout=0.45,  # a busy machine may keep the ring waiting
    watchdog=0.5,
)

LOSING_FRAMES = replace(SETTINGS, reply_timeout=0.15)
"""Where frames are lost: the master polls for that time, and keeps a processor busy meanwhile."""


def rig_of(settings: RigSettings = SETTINGS) -> EthercatRig:
    return hopper_on_ethercat(settings, RobotParameters())


def ticks_until_fault(rig: EthercatRig, ticks: int, torque: float = 8.0) -> tuple[int, str]:
    for tick in range(ticks):
        try:
            rig.read()
            rig.write((torque, -torque))
        except RigFault as fault:
            return tick, str(fault)
    return ticks, ""


@cache
def cycles_to_connect() -> int:
    """Number of frames with outputs that a bring-up takes."""
    with live_ring() as ring, rig_of():
        return ring.look().cycles


def test_torque_and_counts_go_through() -> None:
    with live_ring() as ring, rig_of() as rig:
        first = rig.read()
        already = len(ring.look().torques)
        assert first == (already - 100, -10 * already, -already, 2 * already, pytest.approx(0.5 * already))
        assert rig.read() == first, "no frame, no news"
        sent = [rig.write((torque, 0.5)) for torque in (0.0, 1.2345, -3.0, 50.0) if rig.read()]
        last = rig.read()
        assert last[0] == already + 4 - 100
        given = ring.look().torques
        assert [(a, -b) for a, b in given[already:]] == [pytest.approx(pair) for pair in sent]
        assert sent[1] == pytest.approx((1.232, 0.496))  # thousandths of 16 N·m
        assert sent[3][0] == 20.0
        assert all(torques == (0, 0) for torques in given[:already])
        rig.close()
        assert ring.look().enabled == [False, False]


def test_it_can_be_connected_again() -> None:
    with live_ring() as ring:
        rig = rig_of()
        for _ in range(2):
            rig.connect()
            rig.read()
            assert ring.look().enabled == [True, True]
            rig.write((1.0, 1.0))
            rig.close()
            rig.close()
            assert ring.look().enabled == [False, False]
        with pytest.raises(RigFault, match="not connected"):
            rig.read()


def test_a_second_master_is_refused_and_the_first_one_continues() -> None:
    with live_ring() as ring, rig_of() as first:
        with pytest.raises(RigFault, match=f"another process is already the master of {INTERFACE}"):
            rig_of().connect()
        assert ticks_until_fault(first, 20) == (20, "")
        assert ring.look().enabled == [True, True]
        first.close()
        with rig_of() as second:
            assert ticks_until_fault(second, 20) == (20, "")


def test_the_bus_is_released_if_a_bring_up_is_aborted(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with live_ring() as ring:
        for method in ("_prepare", "_transition", "_update_reading"):
            with monkeypatch.context() as patch:
                patch.setattr(EthercatRig, method, interrupted)
                with pytest.raises(KeyboardInterrupt):
                    rig_of().connect()
            assert ring.look().enabled == [False, False]
        with rig_of() as rig:
            assert ticks_until_fault(rig, 20) == (20, "")


def test_a_drive_whose_error_cannot_be_read_does_not_hide_the_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> int:
        raise RigFault("no answer")

    with live_ring(Fault("trip", cycles_to_connect() + 3, "drive_2")), rig_of() as rig:
        monkeypatch.setattr(rig._bus, "read_object", refused)
        _, message = ticks_until_fault(rig, 20)
    assert message.startswith("slave 2 'drive_2' no longer accepts torque commands: slave 1 'drive_1' is ")
    assert "slave 2 'drive_2' is in state fault, mode 10, its error is unknown" in message


def test_an_error_that_soem_stored_for_another_slave_is_no_answer() -> None:
    def read(_: object) -> bytes:
        raise AssertionError  # as pysoem does

    with (
        live_ring(),
        rig_of() as rig,
        pytest.raises(RigFault, match="0x603F:00 is refused: no answer"),
    ):
        rig._bus._transfer(0, 0x603F, 0, read)


def changed(name: str, **changes: object) -> RigSettings:
    slaves = tuple(replace(slave, **changes) if slave.name == name else slave for slave in SETTINGS.slaves)
    return replace(SETTINGS, slaves=slaves)


SPARE = Slave(name="spare", vendor=2, product=3)
REFUSED = (
    (changed("drive_2", product=7), "slave 2 'drive_2' must be vendor 0x0000009A product 0x00000007, but"),
    (changed("coupler", vendor=7), "slave 3 'coupler' must be vendor 0x00000007 product 0x044C2C52, but"),
    (replace(SETTINGS, slaves=(*SETTINGS.slaves, SPARE)), "slave 7 'spare' is missing: 6 of 7 slaves answer"),
    (changed("boom_vertical", pdos="beckhoff-el5101"), "slave 5 'boom_vertical': object 0x1C12:01 is refused"),
    (
        replace(SETTINGS, motor_1=replace(SETTINGS.motor_1, rated_torque=12.0)),
        "slave 1 'drive_1' has a rated torque of 16 N·m (0x6076), but the settings have 12",
    ),
    (replace(SETTINGS, interface="nowhere"), "interface nowhere cannot be opened"),
)


def test_a_bus_that_differs_from_the_settings_is_refused() -> None:
    with live_ring() as ring:
        for settings, expected in REFUSED:
            with pytest.raises(RigFault) as caught:
                rig_of(settings).connect()
            assert str(caught.value).startswith(expected)
            assert "\n" not in str(caught.value)
            assert ring.look().torques == []


def test_errors_within_the_limits_are_tolerated() -> None:
    at = cycles_to_connect() + 10
    faults = (
        Fault("lost frames", at, cycles=2),
        Fault("late frame", at + 6),
        Fault("duplicated frame", at + 12),
        Fault("unplugged", at + 18, "boom_vertical", cycles=2),
    )
    with live_ring(*faults) as ring, rig_of(LOSING_FRAMES) as rig:
        assert ticks_until_fault(rig, 40) == (40, "")
        behind = ring.look()
        assert behind.enabled == [True, True]
        assert max(abs(torque) for torques in behind.torques for torque in torques) <= 8.0 * (1 + 1e-12)


@pytest.mark.parametrize(
    "fault",
    [
        Fault("lost frames", 10, cycles=3),
        Fault("unplugged", 10, "boom_vertical", cycles=5),
        Fault("power lost", 10, "drive_2", cycles=5),
        Fault("trip", 10, "drive_1"),
        Fault("silence", 10, ticks=600),
    ],
    ids=lambda fault: fault.kind,
)
def test_other_errors_stop_the_motors_for_good(fault: Fault) -> None:
    with live_ring(fault.at(cycles_to_connect() + fault.cycle)) as ring, rig_of(LOSING_FRAMES) as rig:
        ticks, message = ticks_until_fault(rig, 40)
        assert 10 <= ticks <= 16
        assert "\n" not in message
        assert ring.look().now[0] == 0
        for act in (rig.read, lambda: rig.write((0, 0)), rig.connect):
            with pytest.raises(RigFault):
                act()
        rig.close()
        assert ring.look().now == [0, 0]


def test_a_drives_error_is_reported() -> None:
    when = cycles_to_connect() + 3
    faults = Fault("emergency", when - 1, "drive_1", code=0x4210), Fault("trip", when, "drive_2", code=0x2310)
    with live_ring(*faults), rig_of() as rig:
        _, message = ticks_until_fault(rig, 20)
    assert "slave 2 'drive_2' no longer accepts torque commands" in message
    assert "is in state fault, mode 10, error 0x2310" in message
    assert "slave 1 'drive_1' sent emergency 0x4210; slave 2 'drive_2' sent emergency 0x2310" in message


@pytest.mark.parametrize("bad", [nan, inf])
def test_a_torque_that_is_not_finite_never_reaches_a_motor(bad: float) -> None:
    with live_ring() as ring, rig_of() as rig:
        rig.read()
        with pytest.raises(RigFault, match="torques must be finite"):
            rig.write((1.0, bad))
        assert set(ring.look().torques) == {(0, 0)}
        with pytest.raises(RigFault, match="torques must be finite"):
            rig.read()


@pytest.mark.parametrize(
    ("answers", "expected"),
    [
        ([None, None, True, None, None, True], ""),
        ([None, None, None], "slaves did not report their states to 3 requests in a row"),
        ([None, False], "a slave has left OP"),
    ],
)
def test_a_lost_state_reply_is_distinguished_from_a_slave_that_left_op(answers: list, expected: str) -> None:
    with live_ring() as ring, rig_of() as rig:
        remaining = [True, *answers]
        rig._bus.in_operation = lambda: remaining.pop(0) if remaining else True
        _, message = ticks_until_fault(rig, 200)
        assert message.partition(":")[0] == expected
        assert remaining == []
        assert ring.look().enabled == [not expected, not expected]
