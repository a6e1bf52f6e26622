"""The true apex of the twin, compared with its true state at every tick; and the measured apex, compared with it."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.hopper.ring_rig import emulated_settings
from stepgap.hardware.hopper.ring_simulation import DirectRing
from stepgap.plants.rig_plant import RigPlant
from stepgap.rigs.rig import Torques
from stepgap.robots.hopper import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.twin.model import carried_mass
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.true_apex import true_hip
from stepgap.robots.hopper.twin.true_state import TrueState
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import StepRecord, StepStatus
from tests.plants.single_ticks import SingleTicks

ROBOT, COMMAND = RobotParameters(), np.array([-6.0, -3.0])
CONTROL = HopperControl(ROBOT, Gains(), CommandBounds())
NONE = RealityGap.none()
SOFT = replace(NONE, boom_stiffness=2e4, ground_stiffness=5e4)
GAPS = {"preset": RealityGap(), "rigid": RealityGap(boom_stiffness=inf), "plane": SOFT, "none": NONE}


def new_twin(gap: RealityGap = GAPS["preset"], seed: int = 0) -> Twin:
    return Twin(ROBOT, gap, np.random.default_rng(seed), start_speed=0.1)


class Watched(SingleTicks):
    """A twin whose true states at the end of all ticks since the last reading of `states` are kept."""

    def __init__(self, twin: Twin):
        super().__init__(twin)
        self.twin, self.states = twin, list[TrueState]()

    def write(self, torques: Torques) -> Torques:
        applied = super().write(torques)
        self.states.append(self.twin.true_state())
        return applied


def flight_of(states: list[TrueState]) -> list[TrueState]:
    """States since the last tick in which the foot was on the ground."""
    grounded = [number for number, state in enumerate(states) if state.contact_force > 0]
    return states[grounded[-1] + 1 :]


def interpolated_apex(states: list[TrueState]) -> tuple[float, float]:
    """Speed and height where the hip's vertical rate passes zero at its highest point, between two ticks."""
    top = int(np.argmax([state.hip[1] for state in states]))
    first = states[top if states[top].hip_rate[1] > 0 else top - 1]
    second = states[states.index(first) + 1]
    share = first.hip_rate[1] / (first.hip_rate[1] - second.hip_rate[1])
    height = first.hip[1] + 0.5 * share * (second.time - first.time) * first.hip_rate[1]
    return (1 - share) * first.hip_rate[0] + share * second.hip_rate[0], height


@pytest.mark.parametrize("gap", GAPS.values(), ids=GAPS)
def test_it_is_the_highest_point_of_the_flight(gap: RealityGap) -> None:
    rig, singly = Watched(new_twin(gap)), list[StepRecord]()
    with RigPlant(rig, CONTROL) as plant:
        plant.start()
        for _ in range(4):
            rig.states.clear()
            singly.append(plant.take_step(COMMAND))
            flight = flight_of(rig.states)
            highest = max(flight, key=lambda state: state.hip[1])
            assert singly[-1].true_next_state.tolist() == [highest.hip_rate[0], highest.hip[1]]
            off_speed, off_height = abs(singly[-1].true_next_state - interpolated_apex(flight))
            assert off_speed < 1e-4
            assert off_height < 2e-6
    with RigPlant(new_twin(gap), CONTROL) as plant:
        plant.start()
        for expected in singly:
            assert plant.take_step(COMMAND).true_next_state.tolist() == expected.true_next_state.tolist()


@pytest.mark.parametrize("gap", GAPS.values(), ids=GAPS)
def test_the_true_hip_is_where_mujoco_has_it(gap: RealityGap) -> None:
    """At random coordinates and rates; the rate is the derivative of the position."""
    twin, rng = new_twin(gap), np.random.default_rng(4)
    qpos, qvel = np.zeros_like(twin._views.qpos), np.zeros_like(twin._views.qvel)
    qpos[:4], qvel[:4] = rng.uniform(-0.3, 0.3, 4), rng.uniform(-2, 2, 4)
    twin._data.qpos[:], twin._data.qvel[:] = qpos, qvel
    state = twin.true_state()
    assert state.hip[1] == pytest.approx(twin._scratch.body("hopper").xpos[2], abs=1e-12)
    ahead, behind = (true_hip(twin._devices, qpos + step * qvel, qvel)[0] for step in (1e-6, -1e-6))
    np.testing.assert_allclose(np.subtract(ahead, behind) / 2e-6, state.hip_rate, atol=1e-8)


def test_it_is_unknown_before_the_first_take_off() -> None:
    twin = new_twin()
    with RigPlant(twin, CONTROL) as plant:
        assert twin.truth == ()
        plant.start()
        assert len(twin.truth) == 2
        twin.connect()
        assert twin.truth == ()


def test_a_fork_has_the_apex_of_its_origin_and_then_its_own() -> None:
    twin = new_twin()
    with RigPlant(twin, CONTROL) as plant:
        plant.start()
        fork, before = twin.fork(np.random.default_rng(1)), twin.truth
        assert fork.truth == before
        plant.take_step(COMMAND)
        assert fork.truth == before != twin.truth


def test_a_failed_step_has_no_true_state() -> None:
    with RigPlant(new_twin(), CONTROL) as plant:
        plant.start()
        record = plant.take_step(np.array([np.nan, 0.0]))
    assert record.status == StepStatus.INVALID
    assert np.isnan(record.true_next_state).all()


def test_other_rigs_do_not_know_it() -> None:
    twin, ring = new_twin(), RingSettings()
    rig = DirectRing(twin, ring, emulated_settings(twin.sensor_model, ROBOT, ring, "unused"))
    with RigPlant(rig, CONTROL) as plant:
        plant.start()
        record = plant.take_step(COMMAND)
    assert record.status == StepStatus.OK
    assert np.isnan(record.true_next_state).all()
    assert rig.truth == ()


def measured_minus_true(gap: RealityGap) -> np.ndarray:
    """Errors of speed and height at the apexes of 20 hops near 0.2 m/s and 0.58 m; shape (20, 2)."""
    rng, errors = np.random.default_rng(0), list[np.ndarray]()
    with RigPlant(new_twin(gap), CONTROL) as plant:
        state = plant.start()
        for _ in range(20):
            record = plant.take_step(COMMAND - [40, 200] * (state - [0.2, 0.58]) + rng.uniform(-2, 2, 2))
            errors.append(record.next_state - record.true_next_state)
            state = record.next_state
    return np.array(errors)


def test_friction_and_drag_of_the_boom_do_not_bias_the_measured_speed() -> None:
    errors = measured_minus_true(RealityGap(boom_drag=0.2))[:, 0]
    assert abs(errors.mean()) < 5e-4
    assert errors.std() < 1e-3


def test_the_measured_height_is_that_of_the_booms_root() -> None:
    """In flight the tip pulls the boom, which has inertia but no weight, down with it, and so hangs below its root."""
    gap = RealityGap()
    inertia = gap.boom_inertia_scale * ROBOT.boom_inertia_vertical / ROBOT.boom_length**2
    mass = carried_mass(ROBOT, gap)
    force = inertia * ROBOT.gravity * mass / (mass + inertia)
    errors = measured_minus_true(gap)[:, 1]
    assert errors.mean() == pytest.approx(force / gap.boom_stiffness, rel=0.1)
    assert errors.std() < 5e-5
    assert abs(measured_minus_true(replace(gap, boom_stiffness=inf))[:, 1].mean()) < 2e-5
