from itertools import pairwise

import numpy as np
import pytest

from benchmarks.sampled_map import SampledApexMap
from stepgap.control.step_controller import StepController
from stepgap.plants.rig_plant import RigPlant
from stepgap.robots.hopper import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import StepStatus

CONTINUOUS = ApexMap()
RNG = np.random.default_rng(5)
STATES = RNG.uniform([0.0, 0.53], [0.4, 0.63], (12, 2))
COMMANDS = RNG.uniform([-12.0, -15.0], [8.0, 10.0], (12, 2))


def test_ever_shorter_ticks_lead_to_the_continuous_map_in_proportion():
    wanted = CONTINUOUS.evaluate(STATES, COMMANDS).next_state
    errors = [
        np.abs(SampledApexMap(tick=tick).evaluate(STATES, COMMANDS).next_state - wanted).max(axis=0)
        for tick in (1e-3, 1e-4, 1e-5)
    ]
    for longer, shorter in pairwise(errors):
        assert (shorter < 0.2 * longer).all()
    assert (errors[-1] < 5e-4).all()


def test_it_predicts_a_twin_without_gap_at_1_khz():
    """Held torques cause nearly all of the difference between this twin and the continuous map."""
    robot, gains, bounds, rng = RobotParameters(), Gains(), CommandBounds(), np.random.default_rng(2)
    sampled, controller, seen, continuous, held = SampledApexMap(), StepController(CONTINUOUS), [], [], []
    with RigPlant(Twin(robot, RealityGap.none(), rng), HopperControl(robot, gains, bounds)) as plant:
        state = plant.start()
        for _ in range(25):
            record = plant.take_step(controller(state, rng.uniform([0.0, 0.54], [0.4, 0.63])).command)
            seen.append(record.next_state)
            continuous.append(CONTINUOUS(state, record.applied))
            held.append(sampled(state, record.applied))
            state = record.next_state
    without, with_hold = (np.mean(np.subtract(seen, model), axis=0)[1] for model in (continuous, held))
    assert without > 0.01
    assert abs(with_hold) < 0.4 * without


def test_a_batch_is_its_points_and_failures_have_their_reasons():
    batch = SampledApexMap().evaluate(STATES, COMMANDS)
    for i in (0, 7, 11):
        np.testing.assert_array_equal(SampledApexMap()(STATES[i], COMMANDS[i]), batch.next_state[i])
    outcome = SampledApexMap().evaluate([[0.2, 0.2], [0.2, np.nan]], [0, 0])
    assert outcome.status.tolist() == [StepStatus.FOOT_SCUFFED, StepStatus.INVALID]
    assert np.isnan(outcome.next_state).all()


def test_far_outside_the_ranges_it_fails_and_never_hangs_or_gives_nan_for_ok():
    rng = np.random.default_rng(3)
    states, commands = rng.uniform([-3, 0.1], [3, 1.5], (300, 2)), rng.uniform(-300, 300, (300, 2))
    outcome = SampledApexMap().evaluate(states, commands)
    assert (np.isfinite(outcome.next_state).all(axis=1) == (outcome.status == StepStatus.OK)).all()


def test_its_jacobian_is_near_the_continuous_one():
    sampled = SampledApexMap(tick=1e-4).jacobian(STATES[:5], COMMANDS[:5])
    scale = np.abs(CONTINUOUS.jacobian(STATES[:5], COMMANDS[:5])).max(axis=(0, 1), keepdims=True)
    assert (np.abs(sampled - CONTINUOUS.jacobian(STATES[:5], COMMANDS[:5])) < 0.1 * scale).all()


@pytest.mark.parametrize("tick", [0.0, -1e-3, 0.01, np.nan])
def test_a_tick_out_of_range_is_refused(tick):
    with pytest.raises(ValueError, match="tick = "):
        SampledApexMap(tick=tick)
