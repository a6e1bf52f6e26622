"""The first torque: the twin hangs, its wiring is right or wrong, and the jog must find which; without sensors, too."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import degrees, inf, pi, radians, sin, tau

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.hopper.jog import FREQUENCY, LARGEST_TORQUE, MEASURED_TIME, HopperJog, jog_limits
from stepgap.hardware.hopper.jog_trial import (
    MOST_DELAY,
    MOST_DRIVE_DELAY,
    LinkAnswer,
    hand_failure,
    jog_answer,
)
from stepgap.hardware.hopper.ring_rig import emulated_settings
from stepgap.hardware.realtime.board import Board, Request
from stepgap.hardware.realtime.loop import LOOP_UNITS, ControlLoop, LoopSettings
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.rigs.rig import Torques
from stepgap.rigs.wrapped_rig import WrappedRig
from stepgap.robots.hopper import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.sensors import HopperReading
from stepgap.robots.hopper.tick.tick_row import TICK_UNITS
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin

ROBOT = RobotParameters()
COUNTS = 16384
SHIFT = 2 * round(radians(45) / tau * COUNTS)
"""Difference of the motors' counts in the pose of the twin at its start."""


@dataclass(frozen=True)
class Wiring:
    """What is between the computer and the robot.

    Attributes:
        torques: What becomes of the torques.
        reading: What becomes of a reading, given the first one.
    """

    torques: Callable[[float, float], Torques] = lambda torque_1, torque_2: (torque_1, torque_2)
    reading: Callable[[HopperReading, HopperReading], HopperReading] = lambda reading, first: reading


DAMPED = RealityGap(joint_damping=0.05)
"""A limp leg without any friction would fall from the pose of the twin at its start."""
RIGHT = Wiring()
INVERTED_1 = Wiring(lambda torque_1, torque_2: (-torque_1, torque_2))
INVERTED_2 = Wiring(lambda torque_1, torque_2: (torque_1, -torque_2))
EXCHANGED_DRIVES = Wiring(lambda torque_1, torque_2: (torque_2, torque_1))
EXCHANGED_ENCODERS = Wiring(
    reading=lambda now, _: now._replace(motor_1=now.motor_2 + SHIFT, motor_2=now.motor_1 - SHIFT)
)
DISCONNECTED_1 = Wiring(lambda _, torque_2: (0.0, torque_2))
FROZEN_1 = Wiring(reading=lambda now, first: now._replace(motor_1=first.motor_1))
FROZEN_BOTH = Wiring(reading=lambda now, first: now._replace(motor_1=first.motor_1, motor_2=first.motor_2))


class HangingTwin(WrappedRig):
    """The twin, held in the air for good, behind its wiring; it keeps the true counts of its motors."""

    def __init__(self, wiring: Wiring, gap: RealityGap, seed: int):
        self._twin = Twin(ROBOT, gap, np.random.default_rng(seed), hold=1e4)
        super().__init__(self._twin)
        self._wiring = wiring
        self._first: HopperReading | None = None
        self.counts = list[tuple[float, float]]()

    @property
    def limits(self):
        layout = emulated_settings(self._twin.sensor_model, ROBOT, RingSettings())
        return replace(layout.limits, sample_jitter=0.1)

    def read(self):
        reading = self._twin.read()
        self.counts.append((reading.motor_1, reading.motor_2))
        self._first = self._first or reading
        return self._wiring.reading(reading, self._first)

    def write(self, torques):
        self._rig.write(self._wiring.torques(*torques))
        return torques


def jogged(motor: int, wiring: Wiring = RIGHT, gap: RealityGap = DAMPED, seed: int = 0):
    """Ticks of the trial of a motor, the message, and the true largest speed of a link [rad/s]."""
    rows, control = [], HopperJog.of(HopperControl(ROBOT, Gains(), CommandBounds()), motor)
    board = Board.create(2, 2, 1)
    try:
        with HangingTwin(wiring, gap, seed) as rig:
            settings = LoopSettings(stand_time=0.01, landing_time=0.01, release_time=inf)
            loop = ControlLoop(rig, control.control(rig), control.space, board, rows.append, settings)
            board.request = Request.START
            for _ in range(5000):
                if not loop.tick():
                    break
                if board.finished(0):
                    board.request = Request.STOP
            else:
                pytest.fail("it did not end")
            speed = np.abs(np.diff(np.array(rig.counts), axis=0)).max() / COUNTS * tau / rig.sensor_model.tick
            return TickTable({**TICK_UNITS, **LOOP_UNITS}, np.array(rows)), board.message, speed
    finally:
        board.close()
        board.unlink()


GAPS = {
    "friction": RealityGap(joint_friction=0.05),
    "much friction": RealityGap(joint_friction=0.25),
    "viscous friction": DAMPED,
}


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("motor", [1, 2])
def test_a_robot_with_the_right_wiring_passes(motor: int, gap: str) -> None:
    ticks, message, speed = jogged(motor, gap=GAPS[gap], seed=motor)
    answer = jog_answer(ticks, motor)
    assert (message, answer.failure()) == ("", "")
    assert answer.largest_torque <= LARGEST_TORQUE
    assert radians(0.08) <= answer.amplitude < radians(0.6)
    assert speed <= 2.0


@pytest.mark.parametrize(
    ("motor", "wiring", "failure"),
    [
        (1, INVERTED_1, "motor 1: its link moves against the torque"),
        (2, INVERTED_2, "motor 2: its link moves against the torque"),
        (1, EXCHANGED_DRIVES, "motor 1: the encoder of motor 2 moves instead of its own"),
        (2, EXCHANGED_DRIVES, "motor 2: the encoder of motor 1 moves instead of its own"),
        (1, EXCHANGED_ENCODERS, "motor 1: the encoder of motor 2 moves instead of its own"),
        (1, DISCONNECTED_1, "motor 1: no link moves under 1.00 N·m"),
        (1, FROZEN_BOTH, "motor 1: no link moves under 1.00 N·m"),
    ],
)
def test_a_wrong_wiring_is_found_with_a_small_torque_and_speed(motor: int, wiring: Wiring, failure: str) -> None:
    ticks, _, speed = jogged(motor, wiring, seed=7)
    answer = jog_answer(ticks, motor)
    assert answer.failure().startswith(failure)
    assert answer.largest_torque <= LARGEST_TORQUE
    assert speed < 6.0, "also without sensors; full torque in the posture made it 83 rad/s"


def test_a_frozen_encoder_is_found_or_stops_the_trial() -> None:
    ticks, message, speed = jogged(1, FROZEN_1, seed=8)
    assert message or jog_answer(ticks, 1).failure()
    assert speed < 6.0


def test_the_limits_of_a_jog_are_those_of_the_robot_or_smaller() -> None:
    limits = SafetyLimits(torque=0.5, joint_speed=1.5, fold_angle=2.0, first_hops=5)
    found = jog_limits(limits)
    assert (found.torque, found.joint_speed, found.fold_angle) == (0.5, 1.5, 2.0)
    assert jog_limits(SafetyLimits(torque=38.0)).torque == LARGEST_TORQUE


# What is judged, with answers in closed form


def ticks_of(own: Callable[[float], float], other: Callable[[float], float], torque: float = 0.5) -> TickTable:
    """A trial of motor 1 in which the links move as given functions of time."""
    time = np.arange(0, MEASURED_TIME + 0.2, 1e-3)
    units = {"time": "s", "alpha_1": "rad", "alpha_2": "rad", "applied_1": "N·m", "joint_speed": "rad/s"}
    rows = [(t, (own(t) + other(t)) / 2, (own(t) - other(t)) / 2, torque * sin(tau * FREQUENCY * t), 1.0) for t in time]
    return TickTable(units, np.array(rows))


@given(
    amplitude=st.floats(radians(0.1), radians(5)),
    lag=st.floats(0.0, 2 * pi),
    slow=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
)
def test_amplitude_and_lag_are_measured_beside_a_slow_motion(amplitude: float, lag: float, slow) -> None:
    def own(time: float) -> float:
        return amplitude * sin(tau * FREQUENCY * time - lag) + slow[0] * time + slow[1] * time**2

    answer = jog_answer(ticks_of(own, lambda time: slow[0] * time**3), 1)
    assert answer.amplitude == pytest.approx(amplitude, rel=1e-6)
    assert answer.torque == pytest.approx(0.5)
    assert min(abs(answer.lag - lag), 2 * pi - abs(answer.lag - lag)) < 1e-6
    assert answer.other < 1e-9
    behind = degrees(lag)
    if 80 < behind < 210:
        assert answer.failure() == ""
    if behind < 70 or behind > 220:
        assert "against the torque" in answer.failure()


def test_the_inertia_is_that_of_a_free_link() -> None:
    inertia = 0.003
    amplitude = 0.5 / (inertia * (tau * FREQUENCY) ** 2)
    answer = jog_answer(ticks_of(lambda t: -amplitude * sin(tau * FREQUENCY * t), lambda _: 0.0), 1)
    assert answer.inertia == pytest.approx(inertia)
    assert answer.failure() == ""


def test_a_trial_without_enough_torque_is_no_answer() -> None:
    with pytest.raises(ValueError, match="motor 1 got no torque for long enough"):
        jog_answer(ticks_of(lambda _: 0.0, lambda _: 0.0, torque=0.0), 1)


@pytest.mark.parametrize(
    ("motor", "turned", "expected"),
    [
        (1, (45, 0), ""),
        (1, (33, 20), ""),
        (2, (-10, 58), ""),
        (1, (-45, 0), "its sign is wrong"),
        (1, (0.2, 44), "that of motor 2 +44.0°: the two are exchanged"),
        (2, (0.0, 0.0), "it is not connected, or stands still"),
        (1, (11.25, 0), "check counts_per_turn and gear"),
        (1, (180, 0), "check counts_per_turn and gear"),
    ],
)
def test_a_link_that_was_turned_by_hand(motor: int, turned: tuple[float, float], expected: str) -> None:
    failure = hand_failure(motor, (radians(turned[0]), radians(turned[1])))
    assert bool(failure) == bool(expected)
    assert failure.endswith(expected)


def late_answer(link: float, drive: float) -> LinkAnswer:
    """Answer of an inertia that follows the torque after a delay, and a drive that reports it after another one [s]."""

    def own(time: float) -> float:
        return -0.01 * sin(tau * FREQUENCY * (time - link))

    ticks = ticks_of(own, lambda _: 0.0)
    reported = [-31.0 * sin(tau * FREQUENCY * (time - drive)) for time in ticks["time"]]  # it counts backward
    rows = np.column_stack([ticks.rows, reported])
    return jog_answer(TickTable({**ticks.units, "motor_1_torque": "rated torque / 1000"}, rows), 1)


@pytest.mark.parametrize("link", [0.0, 0.001, 0.002, 0.003, 0.005, 0.008])
@pytest.mark.parametrize("drive", [0.001, 0.003, 0.004, 0.006])
def test_delays_of_link_and_drive_are_measured_and_refused_beyond_the_margin(link: float, drive: float) -> None:
    answer = late_answer(link, drive)
    assert answer.delay == pytest.approx(link, abs=1e-6)
    assert answer.drive_delay == pytest.approx(drive, abs=1e-6)
    if link > MOST_DELAY:
        assert f"its link answers {1e3 * link:.1f} ms or more too late" in answer.lateness()
    elif drive > MOST_DRIVE_DELAY:
        assert f"its drive reports the commanded torque {1e3 * drive:.1f} ms later" in answer.lateness()
    else:
        assert answer.lateness() == ""


@pytest.mark.parametrize("gap", GAPS)
def test_a_healthy_robot_is_not_late(gap: str) -> None:
    assert jog_answer(jogged(1, gap=GAPS[gap])[0], 1).lateness() == ""
