"""A limit of the change of the command: all that choose commands keep it, and the best within it is still found."""

from dataclasses import replace

import numpy as np
import pytest

from stepgap.control.cautious_controller import CautiousController
from stepgap.control.reference import Reference
from stepgap.control.settings import ControlSettings
from stepgap.control.wrapped_map import CommandChange
from stepgap.experiment.deployment import DeploymentController, deploy
from stepgap.gym import StepEnv
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.model_plant import ModelPlant
from stepgap.step import Array, Quantity, StepSpace
from tests.control.maps import LossyHopper, NeverWorks, PitchingHopper, StumblingHopper

ROBOT, NONE = LossyHopper(), np.empty((0, 4))
SPACE = ROBOT.space
SHARE = 0.1
ROUNDING = 1e-12
STAIRS = Reference.from_segments(
    ("speed", "height"), [(1, (0.1, 0.55)), (8, (0.35, 0.62)), (16, (0.05, 0.55)), (20, (0.3, 0.6))], steps=26
)


def largest_share(commands: Array) -> float:
    """The largest change of a command between two steps, as a share of its range."""
    return float(np.abs(np.diff(commands, axis=0) / (2 * SPACE.command_scale)).max())


@pytest.mark.parametrize(("robot", "horizon"), [(LossyHopper(), 1), (StumblingHopper(), 2), (PitchingHopper(), 3)])
def test_no_command_of_a_deployment_changes_more(robot: LossyHopper, horizon: int) -> None:
    """Exploration, cautious search while the map is uncertain, and tracking, of one step or of several."""
    space, rng = robot.space, np.random.default_rng(0)
    plant = ModelPlant(replace(robot, mass=1.9), space.state_centre, 0.005 * space.state_scale, rng)
    learner = Learner.start(robot, Steps(space), LearningSettings("linear", online=True), 0)
    control = ControlSettings(horizon=horizon, largest_change=SHARE)
    steps = list(deploy(learner, plant, STAIRS.of(space), 0, exploration=4, control=control))
    assert len(steps) == len(STAIRS) + 4, "the limit made a step fail"
    commands = np.array([logged.record.command for logged in steps])
    assert 0.99 * SHARE < largest_share(commands) <= SHARE + ROUNDING


def test_the_first_command_has_no_limit_and_later_ones_are_the_best_within_it() -> None:
    rng = np.random.default_rng(1)
    settings = ControlSettings(largest_change=SHARE)
    sides = [np.linspace(-1, 1, 41)] * 2
    for _ in range(12):
        state, target = SPACE.state_centre + SPACE.state_scale * rng.uniform(-0.7, 0.7, (2, 2))
        free = CautiousController(ROBOT, ROBOT, NONE)(state, target)
        first = CautiousController(ROBOT, ROBOT, NONE, settings)(state, target)
        assert first.command.tolist() == free.command.tolist()
        previous = SPACE.command_at(rng.uniform(-1, 1, 2))
        found = CautiousController(ROBOT, ROBOT, NONE, settings, previous=previous)(state, target, previous)
        assert largest_share(np.array([previous, found.command])) <= SHARE + ROUNDING
        grid = previous + 2 * SHARE * SPACE.command_scale * np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
        inside = grid[((grid >= SPACE.command_lower) & (grid <= SPACE.command_upper)).all(axis=1)]
        costs = np.sum(((ROBOT(state, inside) - target) / SPACE.state_scale) ** 2, axis=1)
        assert np.sum(((found.predicted - target) / SPACE.state_scale) ** 2) <= costs.min() + 1e-9


def test_a_view_ahead_begins_to_change_the_command_early() -> None:
    def cost(horizon: int) -> float:
        learner = Learner.start(ROBOT, Steps(SPACE), LearningSettings(), 0)
        control = ControlSettings(horizon=horizon, largest_change=SHARE)
        errors = [
            (each.record.next_state - each.target) / SPACE.state_scale
            for each in deploy(learner, ModelPlant(ROBOT, STAIRS.targets[0]), STAIRS, 0, control=control)
        ]
        return float(np.square(errors).sum())

    assert cost(2) < 0.4 * cost(1)


def test_where_no_command_makes_a_step_the_limit_is_kept() -> None:
    learner = Learner.start(NeverWorks(), Steps(SPACE), LearningSettings(), 0)
    previous = SPACE.command_upper
    start = DeploymentController.start(learner, ControlSettings(largest_change=SHARE))
    controller = replace(start, command=previous)
    plan = controller.plan(SPACE.state_centre, SPACE.state_centre)
    np.testing.assert_allclose(plan.command, previous - 2 * SHARE * SPACE.command_scale)


@pytest.mark.parametrize("share", [0.0, -1.0, 1.1, np.nan])
def test_a_limit_is_a_share(share: float) -> None:
    with pytest.raises(ValueError, match=r"largest_change = .*, but it must lie between 0\.001 and 1, the whole range"):
        ControlSettings(largest_change=share)


def test_a_table_has_no_command_before() -> None:
    with pytest.raises(ValueError, match="table = 9, but it must be 0 with a largest_change"):
        ControlSettings(table=9, largest_change=0.5)


def test_an_environment_clips_the_change() -> None:
    env = StepEnv(lambda _: ModelPlant(ROBOT), ROBOT, STAIRS, largest_change=SHARE)
    rng = np.random.default_rng(0)
    for _ in range(2):
        env.reset(seed=0)
        commands = [env.step(np.array([1.0, -1.0]))[4]["command"]]
        assert commands[0].tolist() == [SPACE.command_upper[0], SPACE.command_lower[1]]
        commands += [env.step(rng.uniform(-1, 1, 2))[4]["command"] for _ in range(10)]
        assert 0.99 * SHARE < largest_share(np.array(commands)) <= SHARE + ROUNDING


def test_a_command_outside_its_bounds_counts_as_one_on_them() -> None:
    """Such as one that a person's program applied."""
    space = LossyHopper().space
    far = CommandChange(0.01, space.command_upper + 5).bounds(space)
    near = CommandChange(0.01, space.command_upper).bounds(space)
    assert far == near


def test_bounds_around_a_command_are_within_all_other_limits() -> None:
    space = StepSpace((Quantity("v", "", -1, 1),), (Quantity("c", "", -1, 1),))
    around = np.array([0.3]), np.array([0.8])
    alone = CommandChange(around=around).bounds(space)
    assert (alone.command_lower, alone.command_upper) == (0.3, 0.8)
    both = CommandChange(0.1, np.array([0.2]), around).bounds(space)
    np.testing.assert_allclose([both.command_lower[0], both.command_upper[0]], [0.3, 0.4])


def test_bounds_around_a_command_that_cannot_be_give_way() -> None:
    """The nearest command that the other limits permit."""
    space = StepSpace((Quantity("v", "", -1, 1),), (Quantity("c", "", -1, 1),))
    for around, nearest in ((2.0, 1.0), (-2.0, -1.0)):
        bounds = CommandChange(around=(np.array([around]), np.array([around + 0.5]))).bounds(space)
        np.testing.assert_allclose([bounds.command_lower[0], bounds.command_upper[0]], nearest, atol=1e-5)
        assert bounds.command_lower < bounds.command_upper
