"""The rig on emulated controllers: torques and readings, refused settings, and reactions to faults."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from math import inf, nan
from struct import Struct
from time import perf_counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.hardware.bus_rig import MOST_WRONG
from stepgap.hardware.hopper.moteus import AuxContact, MoteusSettings, hopper_on_moteus
from stepgap.hardware.hopper.twin_machine import TwinMachine
from stepgap.hardware.moteus.can_bus import registers_of, stream_of
from stepgap.hardware.moteus.moteus_rig import MOST_LIMITED, POSITION_COUNTS, MoteusRig
from stepgap.hardware.moteus.moteus_settings import AuxEncoder, Controller
from stepgap.plants.rig_plant import RigPlant
from stepgap.rigs.rig import Rig, RigFault, Torques
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.sensors import HopperReading, HopperSensorModel
from stepgap.robots.hopper.tick.tick_row import TickRow
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from tests.hardware.ethercat.ring_process import Recorder
from tests.hardware.moteus.emulated_moteus import (
    ANALOG,
    ENCODER_1,
    FAULT,
    FAULTED,
    MODE,
    POSITION,
    REGISTER_MAP,
    STOPPED,
    TIMED_OUT,
    VALIDITY,
    Controllers,
    as_varuint,
    emulated,
    reply,
)

ROBOT, GAP = RobotParameters(), RealityGap()
SETTINGS = MoteusSettings(
    interface="virtual",
    channel="never opened",
    pivot_height=GAP.boom_pivot_height,
    motor_1=Controller(id=1, torque_limit=20, gear=2.0, zero=0.25),
    motor_2=Controller(id=2, torque_limit=20, gear=2.0, sign=-1),
    boom_horizontal=AuxEncoder(id=1, source=1, counts_per_turn=5000, zero=100),
    boom_vertical=AuxEncoder(id=2, source=2, counts_per_turn=16384, sign=-1),
    contact=AuxContact(id=2, port=1, pin=3, newton_per_count=0.125, zero=409, touchdown_force=5, takeoff_length=0.273),
    limits=SafetyLimits(torque=20.0),
    reply_timeout=0.4,  # a busy machine may keep the controllers waiting
    watchdog=0.5,
)
CHANNELS = count()


def fresh(settings: MoteusSettings = SETTINGS) -> MoteusSettings:
    """The settings with a separate bus."""
    return replace(settings, channel=f"moteus {next(CHANNELS)}")


@pytest.fixture
def bench() -> Iterator[tuple[Controllers, MoteusRig]]:
    settings = fresh()
    with emulated(settings, Recorder()) as controllers:
        rig = hopper_on_moteus(settings, ROBOT)
        yield controllers, rig
        rig.close()


def ticks_until_fault(rig: Rig, ticks: int) -> tuple[int, str]:
    for tick in range(ticks):
        try:
            rig.read()
            rig.write((8.0, -8.0))
        except RigFault as fault:
            return tick, str(fault)
    return ticks, ""


def test_torque_and_counts_go_through(bench: tuple[Controllers, MoteusRig]) -> None:
    controllers, rig = bench
    rig.connect()
    turn = POSITION_COUNTS * 2 / 16384
    count = already = len(controllers.settle().torques)
    assert rig.read() == (count * turn, 10 * count * turn, -count, 2 * count, 0.5 * count)
    assert rig.read() == rig.read(), "without a frame the reading does not change"
    sent = [rig.write((torque, 0.5)) for torque in (0.0, 1.2345, -3.0, 50.0) if rig.read()]
    assert sent == [(0.0, 0.5), (1.2345, 0.5), (-3.0, 0.5), (20.0, 0.5)]
    assert rig.read()[0] == (already + 4) * turn
    np.testing.assert_allclose(controllers.settle().torques[already:], sent, rtol=1e-6)
    assert set(controllers.torques[:already]) == {(0.0, 0.0)}
    rig.close()
    assert controllers.modes() == [STOPPED, STOPPED]


def test_it_can_be_connected_again(bench: tuple[Controllers, MoteusRig]) -> None:
    controllers, rig = bench
    for _ in range(2):
        rig.connect()
        rig.read()
        rig.write((1.0, 1.0))
        rig.close()
        rig.close()
        assert controllers.modes() == [STOPPED, STOPPED]
    with pytest.raises(RigFault, match="not connected"):
        rig.read()


@pytest.mark.parametrize(
    ("mute", "survives"),
    [({5: {1}}, True), ({5: {1, 2}, 6: {2}}, True), ({5: {2}, 6: {1}, 7: {2}}, False)],
    ids=["one", "two", "three"],
)
def test_missing_answers_are_tolerated_within_the_limit(mute: dict[int, set[int]], survives: bool) -> None:
    settings = fresh()
    with emulated(settings, Recorder()) as controllers, hopper_on_moteus(settings, ROBOT) as rig:
        controllers.mute = mute
        ticks, message = ticks_until_fault(rig, 15)
        if survives:
            assert (ticks, message) == (15, "")
        else:
            assert message == "controller 2 did not answer in time for 3 ticks in a row"
            assert controllers.modes() == [STOPPED, STOPPED]
            for act in (rig.read, lambda: rig.write((0, 0)), rig.connect):
                with pytest.raises(RigFault, match="did not answer"):
                    act()


def test_a_repeated_reading_is_reported_as_stale(bench: tuple[Controllers, MoteusRig]) -> None:
    controllers, rig = bench
    rig.connect()
    stale = []
    controllers.mute = {len(controllers.torques) + 3: {1}}
    for _ in range(6):
        rig.write((0.0, 0.0))
        before = rig.read()
        stale.append(rig.health.stale)
        assert rig.read() == before
    assert stale.count(True) == 1


def test_a_late_answer_is_not_mistaken_for_the_next(bench: tuple[Controllers, MoteusRig]) -> None:
    controllers, rig = bench
    rig.connect()
    rig.write((0.0, 0.0))
    before = rig.read()
    controllers.send_as(1, reply(3, POSITION, [99.0]))
    rig.write((0.0, 0.0))
    assert rig.read()[0] == before[0] + 8


def test_frames_of_others_and_broken_ones_are_ignored(bench: tuple[Controllers, MoteusRig]) -> None:
    controllers, rig = bench
    rig.connect()
    controllers.noise = [(5, reply(3, POSITION, [99.0])), (1, bytes([0x2F, 0x01, 0x00])), (1, b""), (1, b"\x50")]
    for _ in range(3):
        before = rig.read()
        rig.write((0.0, 0.0))
        assert rig.read()[0] == before[0] + 8


@pytest.mark.parametrize(
    ("breaks", "expected"),
    [
        ((2, FAULTED, 34), "controller 2 is in mode fault, fault 34: over voltage"),
        ((1, TIMED_OUT, 0), "controller 1 is in mode timeout"),
        ((1, STOPPED, 0), "controller 1 is in mode"),
    ],
)
def test_a_controller_that_stops_stops_both_for_good(
    bench: tuple[Controllers, MoteusRig], breaks: tuple[int, int, int], expected: str
) -> None:
    controllers, rig = bench
    controllers.breaks = {6: breaks}
    rig.connect()
    ticks, message = ticks_until_fault(rig, 15)
    assert ticks < 9
    assert message.startswith(expected)
    assert "\n" not in message
    assert controllers.modes() == [STOPPED, STOPPED]
    with pytest.raises(RigFault, match="had a fault"):
        rig.connect()


def test_a_controller_at_its_limit_continues(bench: tuple[Controllers, MoteusRig]) -> None:
    controllers, rig = bench
    rig.connect()
    controllers.overrides = {FAULT: 102}
    assert ticks_until_fault(rig, 5) == (5, "")


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ({VALIDITY: 0x03}, "encoder 1 of controller 1 does not work"),
        ({ENCODER_1: 4711.0}, "encoder 1 of controller 1 reports 4711"),
        ({ENCODER_1: nan}, "encoder 1 of controller 1 reports nan"),
        ({POSITION: nan}, "the position of controller 1 is not finite"),
        ({ANALOG[1] + 2: nan}, "the contact force is not finite"),
    ],
    ids=["invalid", "counts", "no share", "no position", "no force"],
)
def test_sensors_that_fail_stop_the_rig(
    bench: tuple[Controllers, MoteusRig], override: dict[int, float], expected: str
) -> None:
    controllers, rig = bench
    rig.connect()
    controllers.overrides = override
    _, message = ticks_until_fault(rig, 3)
    assert message.startswith(expected)
    assert controllers.modes() == [STOPPED, STOPPED]


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ({REGISTER_MAP: 4}, "controller 1 has registers of version 4, but 5 is needed"),
        ({MODE: FAULTED, FAULT: 33}, "controller 1 is in mode fault, fault 33: motor driver"),
    ],
    ids=["firmware", "fault"],
)
def test_controllers_that_do_not_fit_are_refused(
    bench: tuple[Controllers, MoteusRig], monkeypatch: pytest.MonkeyPatch, override: dict[int, float], expected: str
) -> None:
    controllers, rig = bench
    monkeypatch.setattr("stepgap.hardware.moteus.moteus_rig.ANSWER_TIMEOUT", 0.01)
    for controller in controllers.controllers.values():
        controller.prepares = 10**9
    controllers.overrides = override
    with pytest.raises(RigFault, match=expected):
        rig.connect()
    assert controllers.modes() == [STOPPED, STOPPED]


def test_a_fault_from_before_is_reset_by_connecting(bench: tuple[Controllers, MoteusRig]) -> None:
    controllers, rig = bench
    controllers.controllers[2].break_down(FAULTED, 33)
    rig.connect()
    assert ticks_until_fault(rig, 3) == (3, "")


def test_a_bus_without_controllers_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stepgap.hardware.moteus.moteus_rig.ANSWER_TIMEOUT", 0.0)
    rig = hopper_on_moteus(fresh(replace(SETTINGS, reply_timeout=1e-3)), ROBOT)
    with pytest.raises(RigFault, match=r"controller 1 and controller 2 on virtual moteus \d+ did not answer"):
        rig.connect()


def test_a_bus_that_does_not_exist_is_refused() -> None:
    with pytest.raises(RigFault, match="the CAN bus carrier pigeon coop cannot be opened: Unknown interface"):
        hopper_on_moteus(replace(SETTINGS, interface="carrier pigeon", channel="coop"), ROBOT).connect()


@pytest.mark.parametrize("bad", [nan, inf, -inf])
def test_a_torque_that_is_not_finite_never_reaches_a_motor(bench: tuple[Controllers, MoteusRig], bad: float) -> None:
    controllers, rig = bench
    rig.connect()
    rig.read()
    with pytest.raises(RigFault, match="torques must be finite"):
        rig.write((1.0, bad))
    assert controllers.modes() == [STOPPED, STOPPED]
    assert set(controllers.torques) == {(0.0, 0.0)}


@settings(deadline=None)
@given(st.binary(max_size=64), st.sampled_from([b"", bytes([0x2F, 0x01]), bytes([0x21, 0x00, 0x0A])]))
def test_any_frame_is_decoded_or_ignored(data: bytes, head: bytes) -> None:
    registers = registers_of(head + data)
    assert registers is None or all(isinstance(value, (int, float)) for value in registers.values())
    text = stream_of(head + data)
    assert text is None or len(text) <= len(data)


def claiming(kind: int, number: int, first: int) -> bytes:
    """A frame that claims a number of registers, and has the value of none."""
    return bytes([kind]) + as_varuint(number) + as_varuint(first)


@pytest.mark.parametrize("decode", [registers_of, stream_of])
@pytest.mark.parametrize("kind", [0x00, 0x04, 0x10, 0x14, 0x18, 0x1C, 0x20, 0x24])
@given(number=st.integers(0, 2**35), first=st.integers(0, 2**14))
@settings(max_examples=20)
def test_a_frame_may_claim_any_number_of_registers(decode, kind: int, number: int, first: int) -> None:
    """A loop over 2e8 of them would take minutes: hypothesis' deadline is 0.2 s."""
    assert decode(claiming(kind, number, first)) is None


def test_such_a_frame_does_not_keep_a_rig_from_connecting(bench: tuple[Controllers, MoteusRig]) -> None:
    controllers, rig = bench
    controllers.noise = [(1, claiming(0x10, 2 * 10**8, 1))]
    begin = perf_counter()
    rig.connect()
    assert perf_counter() - begin < 20


@pytest.mark.parametrize(
    "data",
    [
        bytes([0x10, 0xFF, 0xFF, 0xFF, 0x7F, 0x00]),
        b"",
        b"\x50" * 8,
        bytes([0x01, 0x00, 0x0A]),
        bytes([0x42, 0x01, 0x80, 0x02]),
    ],
)
def test_frames_that_are_not_answers_are_ignored(data: bytes) -> None:
    assert registers_of(data) is None


# Hops

HOPPER = replace(
    SETTINGS,
    motor_1=Controller(id=7, torque_limit=38.0),
    motor_2=Controller(id=9, torque_limit=38.0, sign=-1, zero=-0.5),
    boom_horizontal=replace(SETTINGS.boom_horizontal, id=7),
    boom_vertical=replace(SETTINGS.boom_vertical, id=9),
    contact=replace(SETTINGS.contact, id=7, touchdown_force=GAP.touchdown_force, takeoff_length=GAP.takeoff_length),
    limits=SafetyLimits.of(ROBOT),
)


class Counted(Rig):
    """The twin as the controllers report it: forces in counts, torques in single precision."""

    def __init__(self, twin: Twin, idle: int):
        self._twin, self._idle = twin, idle

    @property
    def sensor_model(self) -> HopperSensorModel:
        return self._twin.sensor_model

    def connect(self) -> None:
        self._twin.connect()
        for _ in range(self._idle):
            self.write((0.0, 0.0))

    def read(self) -> HopperReading:
        reading, newton = self._twin.read(), HOPPER.contact.newton_per_count
        return reading._replace(contact_force=newton * round(reading.contact_force / newton))

    def write(self, torques: Torques) -> Torques:
        limit, single = HOPPER.motor_1.torque_limit, Struct("<f")
        applied = [min(max(torque, -limit), limit) for torque in torques]
        self._twin.write(tuple(single.unpack(single.pack(torque))[0] for torque in applied))
        return tuple(applied)

    def close(self) -> None:
        self._twin.close()


def hops(rig: Rig) -> tuple[list[np.ndarray], list[TickRow]]:
    rows = []
    with RigPlant(
        rig, HopperControl(ROBOT, Gains(), CommandBounds(), HOPPER.limits), on_ticks=lambda got, step: rows.extend(got)
    ) as plant:
        states = [plant.start()]
        states += [plant.take_step(np.array([-5.0, -5.0])).next_state for _ in range(1)]
    return states, [TickRow(*row) for row in rows]


def test_the_twin_hops_with_the_controllers_as_without_them() -> None:
    hops(Twin(ROBOT, GAP, np.random.default_rng(0)))  # compiles the twin, which would keep the controllers waiting
    settings = fresh(HOPPER)
    with emulated(settings, TwinMachine(Twin(ROBOT, GAP, np.random.default_rng(0)))) as controllers:
        through, ticks = hops(hopper_on_moteus(settings, ROBOT))
    assert np.isfinite(through).all()
    idle = len(controllers.torques) - len(ticks)
    direct, direct_ticks = hops(Counted(Twin(ROBOT, GAP, np.random.default_rng(0)), idle))
    np.testing.assert_allclose(through, direct, rtol=1e-12)
    assert len(ticks) == len(direct_ticks)
    applied, expected = (np.array([(row.applied_1, row.applied_2) for row in got]) for got in (ticks, direct_ticks))
    np.testing.assert_allclose(applied, expected, atol=1e-9)


def test_a_controller_that_ignores_its_torques_stops_the_rig(bench: tuple[Controllers, MoteusRig]) -> None:
    controllers, rig = bench
    controllers.controllers[1].ignores_torques = True
    rig.connect()
    ticks, message = ticks_until_fault(rig, 40)
    assert ticks <= 5 + MOST_WRONG + 1
    assert message == "controller 1: its torque is 0.0 N·m, commanded were 8 N·m"
    assert controllers.modes() == [STOPPED, STOPPED]


def test_a_torque_is_not_judged_if_its_tolerance_is_infinite() -> None:
    settings = fresh()
    unjudged = replace(settings, motor_1=replace(settings.motor_1, torque_tolerance=inf))
    with emulated(unjudged, Recorder()) as controllers, hopper_on_moteus(unjudged, ROBOT) as rig:
        controllers.controllers[1].ignores_torques = True
        rig.connect()
        assert ticks_until_fault(rig, 40) == (40, "")


def test_a_controller_at_a_limit_may_give_less_torque(bench: tuple[Controllers, MoteusRig]) -> None:
    controllers, rig = bench
    controllers.controllers[1].ignores_torques = True
    rig.connect()
    controllers.controllers[1].fault = 97
    assert ticks_until_fault(rig, 40) == (40, "")


def test_a_controller_that_answers_every_third_time_stops_the_rig() -> None:
    """It never misses more ticks in a row than are allowed."""
    settings = fresh(replace(SETTINGS, reply_timeout=0.01))
    with emulated(settings, Recorder()) as controllers, hopper_on_moteus(settings, ROBOT) as rig:
        rig.connect()
        controllers.mute = {tick: {2} for tick in range(5, 200) if tick % 3}
        ticks, message = ticks_until_fault(rig, 100)
        assert 20 < ticks < 60
        assert message.startswith("controller 2 did not answer in time for 3")
        assert message.endswith("% of the last ticks")
        assert controllers.modes() == [STOPPED, STOPPED]


def test_a_controller_at_a_limit_for_long_is_warned_of() -> None:
    settings = fresh()
    with emulated(settings, Recorder()) as controllers, hopper_on_moteus(settings, ROBOT) as rig:
        controllers.controllers[2].fault = 97
        for _ in range(MOST_LIMITED - 1):
            rig.write((0.0, 0.0))
            rig.read()
            assert rig.warning == ""
        for _ in range(2):
            rig.write((0.0, 0.0))
            rig.read()
        assert rig.warning == "controller 2 is at one of its limits (fault 96 to 103)"
