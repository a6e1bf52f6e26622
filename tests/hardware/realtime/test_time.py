"""The loop's time when frames are lost and ticks are late: there is no clock, the pace defines the time."""

from math import inf, sin, tau

import numpy as np
import pytest

from stepgap.hardware.realtime.board import Board, Request
from stepgap.hardware.realtime.loop import ControlLoop, LoopSettings
from stepgap.rigs.rig import HEALTHY, Health, Rig, RigFault
from stepgap.robots.hopper import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopControl
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.sensors import HopperReading, HopperSensorModel
from tests.rig_ticks import LOG_UNITS

ROBOT, GAINS, BOUNDS = RobotParameters(), Gains(), CommandBounds()
LIMITS = SafetyLimits(torque=38.0, late_ticks=50)
TICK, COUNTS = 1e-3, 2**24
SWING, FREQUENCY = 0.3, 20.0
"""Amplitude [rad] and angular frequency [rad/s] of both angles; as fast as a hop's."""
FASTEST, HARDEST = SWING * FREQUENCY, SWING * FREQUENCY**2
"""Largest rate [rad/s] and its largest change [rad/s²]."""
COLUMN = {name: index for index, name in enumerate(LOG_UNITS)}


class SwingingRig(Rig):
    """A leg that swings independently of its torque; it is sensed when torques are written, unless a frame is lost."""

    def __init__(self, frames=1, lost=lambda: False):
        self._layout = HopperSensorModel(
            tick=TICK,
            boom_length=1.85,
            pivot_height=0.4,
            motor_counts=COUNTS,
            boom_counts_horizontal=5000,
            boom_counts_vertical=16384,
            touchdown_force=5.0,
            takeoff_length=0.273,
            frames_per_tick=frames,
            sampled_at_write=True,
        )
        self.now, self.written, self._lost, self._health = 0.0, [], lost, HEALTHY
        self._reading = self._flying = self._sense()
        self.fails_after = 10**9

    def _sense(self):
        leg_angle = SWING * sin(FREQUENCY * self.now)
        fold = 1.0 + SWING * sin(FREQUENCY * self.now)
        scale = COUNTS / tau
        return HopperReading(scale * (leg_angle + fold), scale * (leg_angle - fold), 0, 0, 0.0)

    @property
    def sensor_model(self):
        return self._layout

    @property
    def health(self):
        return self._health

    def connect(self): ...

    def read(self):
        if self._lost():
            self._health = Health(stale=True)
        else:
            self._health, self._reading = HEALTHY, self._flying
        return self._reading

    def write(self, torques):
        if len(self.written) >= self.fails_after:
            raise RigFault("it broke")
        self.written.append(torques)
        self._flying = self._sense()
        return torques

    def close(self): ...


class WatchedControl(HopControl):
    """Records what it sensed, and when."""

    sensed: list

    def tick(self, time, reading, order, applied, health=HEALTHY, age=0.0):
        computed = super().tick(time, reading, order, applied, health, age)
        motion = self.motion
        self.sensed.append((time, motion.rate_1, motion.rate_2))
        return computed


def swing(rig, ticks, late=lambda: 0.0):
    """Runs a limp rig: returns the board's counts of ticks and missed ticks, what was sensed, and the log."""
    control, board, rows = WatchedControl(rig.sensor_model, ROBOT, GAINS, LIMITS), Board.create(2, 2, 1), []
    control.sensed = []
    loop = ControlLoop(rig, control, BOUNDS.space(), board, rows.append, LoopSettings(release_time=inf))

    def pace(due):
        if due > 0:
            rig.now = max(rig.now, due) + late()
        if len(rows) == ticks:
            board.request = Request.STOP
        return rig.now

    loop.run(pace)
    counted = board.ticks, board.missed_ticks
    board.close()
    board.unlink()
    return counted, np.array(control.sensed), np.array(rows)


@pytest.mark.parametrize("frames", [1, 4])
@pytest.mark.parametrize("loss", [0.0, 0.1])
@pytest.mark.parametrize("stall", [0.0, 0.006])
def test_rates_are_right_despite_lost_frames_and_late_ticks(frames, loss, stall):
    rng, in_a_row = np.random.default_rng(4), 0

    def lost():
        nonlocal in_a_row
        in_a_row = in_a_row + 1 if in_a_row < 2 and rng.random() < loss else 0
        return in_a_row > 0

    def late():
        return rng.exponential(stall) if rng.random() < 0.1 / frames else 0.0

    rig = SwingingRig(frames, lost)
    _, sensed, rows = swing(rig, 2000, late)
    time, *rates = sensed.T
    true = FASTEST * np.cos(FREQUENCY * time)
    begun = np.concatenate([np.zeros(8), rows[:, 0]])[: len(time) + 8]
    oldest = time - begun[2 : len(time) + 2]  # two readings more than one for the bus, and two lost in a row each time
    for rate in rates:
        error = np.abs(rate - true)[8:]
        assert (error <= HARDEST * oldest[8:] + 1e-3).all()
        assert np.sqrt(np.mean(error**2)) < 0.2 * FASTEST


def test_time_advances_while_ticks_are_missed():
    stalls = iter([0.0] * 100 + [0.0075] + [0.0] * 10_000)
    (ticks, missed), _, rows = swing(SwingingRig(), 200, lambda: next(stalls))
    assert (ticks, missed) == (len(rows), 7)
    assert np.diff(rows[:, 0])[100] == pytest.approx(TICK + 0.0075)
    np.testing.assert_allclose(np.delete(np.diff(rows[:, 0]), 100), TICK)
    assert rows[101, COLUMN["late"]] == pytest.approx(0.0075)


def test_the_time_that_a_tick_took_is_in_the_next_row():
    rig, works = SwingingRig(), iter([0.0] * 20 + [0.4e-3] + [0.0] * 10_000)
    write = rig.write

    def slow_write(torques):
        rig.now += next(works)
        return write(torques)

    rig.write = slow_write
    _, _, rows = swing(rig, 40)
    took = np.zeros(len(rows))
    took[21] = 0.4e-3
    np.testing.assert_allclose(rows[:, COLUMN["took"]], took, atol=1e-12)


def test_delays_of_the_frames_between_two_ticks_add_up():
    """Each of four frames comes less than a tick late, the tick after them by more than three."""
    stalls = iter([0.0] * 40 + [0.9e-3] * 4 + [0.0] * 10_000)
    (_, missed), _, rows = swing(SwingingRig(frames=4), 100, lambda: next(stalls))
    late = rows[:, COLUMN["late"]]
    assert late.max() == pytest.approx(4 * 0.9e-3 - 0.75e-3)
    assert missed == 2


def test_a_short_stall_of_a_fast_bus_makes_no_tick_late():
    stalls = iter([0.0] * 40 + [0.6e-3] + [0.0] * 10_000)
    rig = SwingingRig(frames=4)
    (_, missed), _, rows = swing(rig, 100, lambda: next(stalls))
    assert missed == 0
    np.testing.assert_allclose(rows[:, 0], TICK * np.arange(len(rows)), atol=1e-12)
    assert len(rig.written) == pytest.approx(4 * len(rows), abs=4), "no frame is left out"


def test_a_rig_that_fails_between_two_ticks_is_logged():
    rig = SwingingRig(frames=4)
    rig.fails_after = 41
    _, _, rows = swing(rig, 100)
    assert len(rows) == 12
    assert np.isnan(rows[-1, COLUMN["applied_1"]])
    assert rows[-1, 0] == pytest.approx(10.25e-3)


@pytest.mark.parametrize("frames", [1, 4])
def test_a_rig_with_its_own_clock_shifts_its_ticks(frames, monkeypatch):
    rig, shifts = SwingingRig(frames), iter([0.4e-3] + [1e-7] * 100 + [-1e-7] * 10_000)
    monkeypatch.setattr(rig, "clock_correction", lambda _: next(shifts))
    _, _, rows = swing(rig, 201)
    assert rows[0, 0] == pytest.approx(0.4e-3)
    np.testing.assert_allclose(np.diff(rows[:101, 0]), TICK + 1e-7)
    np.testing.assert_allclose(np.diff(rows[101:201, 0]), TICK - 1e-7)
    np.testing.assert_allclose(rows[:, COLUMN["late"]], 0, atol=1e-12)
