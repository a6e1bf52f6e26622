"""The compiled tick compared with a slow reference in plain Python, and its fitness for a real-time process."""

import subprocess
import sys
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from numba import njit
from numpy.testing import assert_allclose

from stepgap.base.compiled import AS_WRITTEN
from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.tick_control import Mode, Order, TickFlag
from stepgap.rigs.rig import HEALTHY, LOST, Health
from stepgap.robots.hopper import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.estimator import FlightFit, fitted_apex, with_sample
from stepgap.robots.hopper.tick.hop_control import NO_COMMAND, HopControl, HopperControl
from stepgap.robots.hopper.tick.hop_state import HopState
from stepgap.robots.hopper.tick.hop_tick import tick
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.phases import Phase
from stepgap.robots.hopper.tick.safety import Limited
from stepgap.robots.hopper.tick.sensors import HopperReading, HopperSensorModel
from stepgap.robots.hopper.tick.tick_row import TICK_COLUMN
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import StepStatus
from tests.robots.hopper.tick import reference_control
from tests.robots.hopper.tick.reference_control import ReferenceControl

ROBOT, GAINS, BOUNDS = RobotParameters(), Gains(), CommandBounds()
SENSORS = HopperSensorModel(
    tick=1e-3,
    boom_length=1.854,
    pivot_height=0.4,
    motor_counts=16384.0,
    boom_counts_horizontal=5000.0,
    boom_counts_vertical=16384.0,
    touchdown_force=5.0,
    takeoff_length=0.287,
)
TIGHT = SafetyLimits(
    torque=30.0,
    torque_step=5.0,
    joint_speed=80.0,
    lean_angle=1.2,
    fold_angle=2.5,
    longest_leg=0.31,
    lowest_hip=0.1,
    highest_hip=0.9,
)
LOOSE = SafetyLimits(torque=40.0, joint_speed=inf)


STAGES = ((Mode.LAND, 7000, 2000), (Mode.STEP, 400, 6600), (Mode.POSTURE, 100, 200), (Mode.LIMP, 0, 100))
"""Mode, first tick and length of the stages of a deployment, the last one first."""


def assert_near(found, expected):
    """As `assert_allclose` with 1e-9; that one takes longer than the two controls that are compared."""
    if not all(abs(one - other) <= 1e-9 + 1e-9 * abs(other) for one, other in zip(found, expected, strict=True)):
        assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


class Both:
    """The compiled control and the reference, ticked with the same inputs and compared."""

    def __init__(self, sensors, limits):
        self.sensors = sensors
        self.tested = HopControl(sensors, ROBOT, GAINS, limits)
        self.reference = ReferenceControl(sensors, ROBOT, GAINS, limits)
        self.mode, self.applied, self.command, self.seen = Mode.STEP, (0.0, 0.0), None, set()

    def tick(self, reading, order, health=HEALTHY, cut=1.0):
        """Computes a tick, after which the motors give a part of the torque; returns whether both still hop."""
        reference = self.reference
        reference.begin_tick()
        (torque_1, torque_2), flags = self.tested.tick(reference.time, reading, order, self.applied, health)
        reference.sense(reading, stale=health.stale)
        if order.mode == Mode.STEP and self.mode != Mode.STEP:
            reference.await_release()
            self.command = None
        self.mode = order.mode
        asked = self._asked(order)
        checked = reference.check(asked if order.mode != Mode.LIMP else (0.0, 0.0), health)
        self.applied = (cut * checked.torque_1, cut * checked.torque_2)
        reference.close_tick(asked, self.applied, checked)
        assert_near((torque_1, torque_2), (checked.torque_1, checked.torque_2))
        self._compare(asked, checked)
        limited = Limited(checked.limited)
        self.seen.add((order.mode, Phase(reference.phase), StepStatus(reference.reason), limited))
        if order.mode == Mode.STEP and not limited.stops:
            self._compare_end(flags)
        assert bool(flags & TickFlag.FAILED) == (reference.reason != StepStatus.OK)
        assert bool(flags & TickFlag.STOPPED) == limited.stops
        assert bool(flags & TickFlag.BRAKES) == (limited.stops and reference.brakes)
        assert bool(flags & TickFlag.TAKES_COMMAND) == reference.takes_command
        return reference.reason == StepStatus.OK

    def _asked(self, order):
        reference = self.reference
        if order.mode == Mode.POSTURE:
            torque_1, torque_2 = reference.posture_torque()
            return order.share * torque_1, order.share * torque_2
        if order.mode == Mode.LAND:
            return reference.landing_torque(order.share)
        if order.mode == Mode.STEP and reference.takes_command and not np.isnan(order.command[0]):
            self.command = order.command
        return reference.hop_torque(self.command or (0.0, 0.0))

    def _compare(self, asked, checked):
        row = self.tested.row((0.0, 0.0))
        assert_near((row[TICK_COLUMN.asked_1], row[TICK_COLUMN.asked_2]), asked)
        assert row[TICK_COLUMN.phase] == self.reference.phase
        assert row[TICK_COLUMN.limited] == checked.limited

    def _compare_end(self, flags):
        finished = self.reference.finished_hop()
        assert bool(flags & TickFlag.STEP_ENDED) == (finished is not None)
        if finished:
            found = self.tested.finished_step()
            assert_allclose(found.state, finished.state, rtol=1e-9, atol=1e-9)
            assert_allclose(found.lost, finished.lost, rtol=1e-9, atol=1e-9)
            assert found.context == (finished.yaw,)
            assert_allclose(found.command, self.command or NO_COMMAND)
            self.command = None


def test_on_the_twin_it_equals_the_reference():
    """Also where motors give less than requested, frames are lost, and the robot is released and landed."""
    rng, twin = np.random.default_rng(1), Twin(ROBOT, RealityGap(), np.random.default_rng(0), hold=0.5)
    twin.connect()
    both, heights, reading = Both(twin.sensor_model, LOOSE), set(), twin.read()
    for number in range(9000):
        mode, begin, length = next(stage for stage in STAGES if number >= stage[1])
        order = Order(mode, min(1.0, (number - begin) / length), (-5.0, -4.0) if rng.random() < 0.5 else NO_COMMAND)
        lost = number % 97 == 96
        reading = reading if lost else twin.read()
        both.tick(reading, order, LOST if lost else HEALTHY, cut=0.98)
        twin.write(both.applied)
        heights.add(both.tested.finished_step().state[1])
    ended = np.isfinite(list(heights)).sum()
    assert ended >= 6
    assert {mode for mode, *_ in both.seen} == set(Mode) - {Mode.TORQUE}
    assert {phase for _, phase, *_ in both.seen} == set(Phase)


def random_reading(rng, number):
    """Random reading of a leg that bends and stretches and a hip that moves up and down, with noise and outliers."""
    swing = np.sin(number / 90.0)
    fold, leg_angle = 0.85 + 0.5 * swing + rng.normal(0, 0.02), rng.normal(0, 0.05)
    counts = np.array([leg_angle + fold, leg_angle - fold]) * 16384 / (2 * np.pi)
    force = max(0.0, rng.normal(-300 * swing, 10))
    heights = 16384 / (2 * np.pi) * (0.08 + 0.12 * swing)
    values = [*np.rint(counts).tolist(), float(round(number / 30)), float(round(heights)), force]
    if rng.random() < 5e-4:
        values[rng.integers(4)] *= 50
    return HopperReading(*values)


@pytest.mark.parametrize("seed", range(4))
def test_random_sequences_give_the_results_of_the_reference(seed):
    rng, both = np.random.default_rng(seed), Both(SENSORS, TIGHT if seed % 2 else LOOSE)
    mode = Mode.STEP
    for number in range(4000):
        if rng.random() < 0.002:
            mode = Mode(rng.integers(4))
        lost, stale, late, stop = (rng.random(4) < [0.02, 0.02, 0.01, 1e-4]).tolist()
        health = Health(lost, stale, int(late), stop)
        command = tuple(rng.normal(0, 8, 2).tolist()) if rng.random() < 0.5 else NO_COMMAND
        both.tick(random_reading(rng, number), Order(mode, rng.random(), command), health, cut=rng.uniform(0.8, 1))
    assert len(both.seen) > 4


@pytest.mark.parametrize("sensor", HopperReading._fields)
@pytest.mark.parametrize("bad", [nan, inf])
def test_a_reading_that_is_not_finite_gives_no_torque_and_changes_nothing(sensor, bad):
    control = HopControl(SENSORS, ROBOT, GAINS, LOOSE)
    before = control.observe(HopperReading(100.0, -100.0, 0.0, 0.0, 0.0))
    reading = HopperReading(100.0, -100.0, 0.0, 0.0, 0.0)._replace(**{sensor: bad})
    torques, flags = control.tick(1.0, reading, Order(Mode.STEP, 1.0, (0.0, 0.0)), (0.0, 0.0))
    assert (torques, flags) == ((0.0, 0.0), TickFlag.UNREADABLE)
    assert_allclose(np.array(flat(control.state)), np.array(flat(before)))


def flat(state):
    """All numbers of a state, in one sequence."""
    return [number for value in state for number in (flat(value) if isinstance(value, tuple) else [value])]


def test_a_torque_that_is_no_number_stops_the_robot():
    control = HopControl(SENSORS, ROBOT, GAINS, LOOSE)
    order = Order(Mode.STEP, nan, (0.0, 0.0))._replace(mode=Mode.POSTURE)
    torques, flags = control.tick(0.0, HopperReading(1000.0, -1000.0, 0.0, 100.0, 0.0), order, (0.0, 0.0))
    assert torques == (0.0, 0.0)
    assert flags & TickFlag.STOPPED
    assert control.stopped == "not finite"
    assert Limited(control.state.watch.stopped) == Limited.NOT_FINITE


def test_sums_of_powers_fit_as_well_as_all_samples():
    """The fits agree up to a flight of 1 s, three times the longest one of the reference."""
    rng = np.random.default_rng(2)
    for _ in range(300):
        number = int(rng.integers(10, 1000))
        times = np.cumsum(rng.uniform(0.5e-3, 1.5e-3, number))
        heights = rng.uniform(0.2, 0.9) + rng.uniform(0, 3) * times - rng.uniform(2, 10) / 2 * times**2
        travelled = rng.uniform(-0.5, 0.5) * times + rng.uniform(-1, 1) * times**2
        travelled, heights = np.array([travelled, heights]) + rng.normal(0, 1e-3, (2, number))
        fit, samples = FlightFit(), reference_control.FlightFit()
        for sample in np.column_stack([times, travelled, heights]).tolist():
            fit = with_sample(fit, *sample)
            samples.add(*sample)
        count = rng.uniform(1e-4, 5e-3)
        if np.polyfit(times, heights, 2)[0] < -0.5 and times[-1] > 0.05:
            assert fitted_apex(fit, count) == pytest.approx(samples.apex(count), rel=1e-9, abs=1e-10)


def test_the_tick_allocates_no_memory_and_needs_no_interpreter_lock():
    HopControl(SENSORS, ROBOT, GAINS, LOOSE)
    compiled: Any = tick
    fresh = njit(**AS_WRITTEN)(compiled.py_func)  # code from the cache cannot be inspected
    fresh.compile(compiled.signatures[0])
    (code,) = fresh.inspect_llvm().values()
    parts = [part for part in code.split("define ") if "cpython" not in part.partition("{")[0]]
    body = max(parts, key=len)  # without the wrapper for Python, which makes objects of the results
    assert "fmul" in body
    assert "alloc(" not in body.replace("alloca(", "")
    assert "NRT_" not in body
    assert compiled.targetoptions["nogil"]


def test_two_controls_do_not_disturb_each_other():
    twin = Twin(ROBOT, RealityGap(), np.random.default_rng(0))
    with RigPlant(twin, HopperControl(ROBOT, GAINS, BOUNDS)) as plant:
        plant.start()
        HopControl(twin.sensor_model, ROBOT, GAINS, LOOSE).observe(HopperReading(0.0, 0.0, 0.0, 0.0, 50.0))
        assert plant.take_step(np.array([-4.0, -3.0])).status == StepStatus.OK
    fresh = HopControl(twin.sensor_model, ROBOT, GAINS, LOOSE).state
    assert_allclose(np.array(flat(fresh)), np.array(flat(HopState())))


AT_THE_SAME_TIME = """
from concurrent.futures import ThreadPoolExecutor
import numpy as np
from stepgap.robots.hopper import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import NO_COMMAND, HopperControl
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
control = HopperControl(RobotParameters(), Gains(), CommandBounds())
twin = Twin(RobotParameters(), RealityGap(), np.random.default_rng(0))
with ThreadPoolExecutor(8) as threads:
    print(len(list(threads.map(control.control, [twin] * 8))))
"""


def test_threads_may_make_the_first_controls_at_the_same_time():
    """The page of a run simulates several deployments at the same time."""
    made = subprocess.run([sys.executable, "-c", AT_THE_SAME_TIME], capture_output=True, text=True, check=False)
    assert (made.stdout, made.stderr) == ("8\n", "")
