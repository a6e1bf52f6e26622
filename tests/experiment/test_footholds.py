"""Distances that add up, such as those from foothold to foothold: targets, starts, reach, and the settings of them."""

from pathlib import Path

import numpy as np
import pytest

from stepgap.base.errors import InputError
from stepgap.control.cautious_controller import CautiousPlan
from stepgap.control.reach import reach_from
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import asked, beyond_reach
from stepgap.experiment.settings import read_experiment
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.plant import Touchdown
from stepgap.robots.ground import UnevenGround
from stepgap.robots.hopper.footholds import STRIDES_GIVEN, stones_reference
from stepgap.robots.hopper.robot import Hopper
from stepgap.step import Quantity, difference_jacobian

HOPPER = Hopper(ground=UnevenGround(footholds=True))
SPACE = HOPPER.space
REFERENCE = Reference(("height", "stride"), np.array([[0.58, 0.2], [0.58, 0.3], [0.58, 0.1]])).of(SPACE)


def test_what_a_step_falls_short_of_is_asked_of_the_next_one():
    assert asked(REFERENCE, 1, SPACE, {"foothold": 0.0})[2] == pytest.approx(0.2)
    np.testing.assert_allclose(asked(REFERENCE, 3, SPACE, {"foothold": 0.46}), [np.nan, 0.58, 0.5 + 0.1 - 0.46])
    np.testing.assert_array_equal(asked(REFERENCE, 2, SPACE, {}), REFERENCE.targets[1])
    plain = Hopper().space
    reference = Reference(("speed", "height"), np.array([[0.2, 0.58]]))
    assert asked(reference, 1, plain, {}) is not None
    np.testing.assert_array_equal(asked(reference, 1, plain, {"foothold": 9.0}), [0.2, 0.58])


def test_a_distance_begins_anew_with_each_step():
    context = (0.0, 0.01, 1.5, 0.0, 0.0)  # yaw, ground, foothold, slope, yielding
    np.testing.assert_allclose(SPACE.above(np.array([0.3, 0.58, 1.7]), context), [0.3, 0.57, 0.2])
    np.testing.assert_allclose(SPACE.start(np.array([0.3, 0.58, 1.7]), context), [0.3, 0.57, 0.0])
    plain = Hopper().space
    state = np.array([0.3, 0.58])
    assert plain.onward(state) is state
    with pytest.raises(ValueError, match="adds_up = true, but it must be false without above"):
        Quantity("stride", "m", 0, 1, adds_up=True)


def learned_map() -> CorrectedMap:
    """A map learned from a few hops, whose errors depend on state and command."""
    rng, nominal, count = np.random.default_rng(0), HOPPER.apex_map(), 30
    state = np.column_stack([rng.uniform(0.1, 0.4, count), rng.uniform(0.55, 0.62, count), np.zeros(count)])
    command = rng.uniform([-8, -6], [4, 4], (count, 2))
    error = np.column_stack([0.1 * state[:, 0], 0.01 * state[:, 1], 0.2 * state[:, 0] + 1e-3 * command[:, 0]])
    next_state = nominal.evaluate(state, command).next_state + error + rng.normal(0, 1e-3, (count, 3))
    log = Steps.of_columns(SPACE, state=state, command=command, next_state=next_state, context=0.0)
    learner = Learner.start(nominal, log, LearningSettings(residual="linear"), 1)
    return learner.step_map()


def test_a_learned_map_does_not_depend_on_a_distance_of_the_step_before():
    step_map, command = learned_map(), np.array([-2.0, -1.0])
    states = np.array([[0.3, 0.58, 0.0], [0.3, 0.58, 0.4]])
    found = step_map.evaluate(states, command).next_state
    np.testing.assert_array_equal(found[0], found[1])
    assert np.abs(found[0] - HOPPER.apex_map().evaluate(states[0], command).next_state).max() > 0.01
    std = step_map.std(states, command)
    np.testing.assert_array_equal(std[0], std[1])
    jacobian = step_map.jacobian(states[1], command)
    assert not jacobian[:, 2].any()
    np.testing.assert_allclose(jacobian, difference_jacobian(step_map, states[1], command), atol=1e-5)
    assert not step_map.std_gradient(states[1], command)[:, 2].any()


def test_a_foothold_that_no_command_reaches_is_named():
    step_map, state = HOPPER.apex_map(), np.array([0.25, 0.58, 0.0])
    least, most = reach_from(step_map, state)
    assert least[2] < 0.1 < 0.4 < most[2]
    found = Touchdown(state, {"foothold": 3.0})
    for stride, sentences in ((most[2] + 0.1, 1), (most[2] - 0.1, 0), (np.nan, 0)):
        target, short = np.array([np.nan, 0.58, stride]), np.array([0.4, 0.58, stride - 0.1])
        named = list(beyond_reach(step_map, found, target, CautiousPlan(np.zeros(2), short, np.zeros(3))))
        assert len(named) == sentences
    wanted = most[2] + 0.1
    target = np.array([np.nan, 0.58, wanted])
    (sentence,) = beyond_reach(step_map, found, target, CautiousPlan(np.zeros(2), target - 0.1, np.zeros(3)))
    assert sentence.startswith(f"the next foothold, at {3 + wanted:.3f} m, is {wanted:.3f} m away, but commands reach ")


def test_stones_are_a_reference():
    hopper = Hopper(ground=UnevenGround(stone_spacing=0.3, stone_spread=0.1))
    length = 2 * np.pi * hopper.parameters.boom_length
    stones = hopper.ground.stones(length)
    reference = hopper.references()["stones"]()
    places = np.cumsum(reference.targets[:, 1])
    assert len(reference) == STRIDES_GIVEN
    lap, number = np.divmod(np.arange(1, STRIDES_GIVEN + 1), len(stones))
    np.testing.assert_allclose(places, stones[number] + lap * length)
    assert stones_reference(stones, length).names == ("height", "stride")


def test_settings_with_footholds_have_their_references(tmp_path: Path):
    assert read_experiment(None, [("ground.footholds", "true")]).reference == "strides"
    assert read_experiment(None, [("ground.stone_spacing", "0.3")]).reference == "stones"
    assert read_experiment(None, [("ground.stair_height", "0.03")]).reference == "paper"
    assert not Hopper(ground=UnevenGround(footholds=True)).published()
    with pytest.raises(InputError, match="--explore = 5, but distances add up from step 1"):
        read_experiment(None, [("ground.footholds", "true"), ("learning.exploration", "5")])
