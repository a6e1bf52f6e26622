"""The choice of a command keeps to its budget of evaluations, and a large budget changes nothing."""

from dataclasses import replace

import numpy as np
import pytest

from stepgap.control.cautious_controller import CautiousController
from stepgap.control.settings import ControlSettings
from stepgap.control.wrapped_map import BudgetedMap, EvaluationBudget
from stepgap.step import Array, Codes, StepStatus, difference_jacobian
from tests.control.maps import CountingMap, LossyHopper
from tests.control.test_cautious_controller import Guessed

NO_FAILURES = np.empty((0, 4))
COUNT_OF_THE_PLAN = 1
"""The prediction for the chosen command is made whatever the budget."""


def points(seed: int) -> tuple[Array, Array]:
    """A state and a target; far targets are out of reach."""
    space, rng = LossyHopper().space, np.random.default_rng(seed)
    state, target = space.state_centre + space.state_scale * rng.uniform(-1.5, 1.5, (2, 2))
    return state, target


@pytest.mark.parametrize("evaluations", [20, 60, 200, 1000])
@pytest.mark.parametrize("seed", range(8))
def test_a_plan_evaluates_no_more_steps_than_its_budget(seed: int, evaluations: int) -> None:
    state, target = points(seed)
    nominal, guessed = CountingMap(LossyHopper()), CountingMap(Guessed(growth=(0.1, 0.1)))
    plan = CautiousController(guessed, nominal, NO_FAILURES, ControlSettings(evaluations=evaluations))(state, target)
    assert 0 < nominal.cost + guessed.cost <= evaluations + COUNT_OF_THE_PLAN
    space = nominal.space
    assert ((space.command_lower <= plan.command) & (plan.command <= space.command_upper)).all()
    np.testing.assert_array_equal(plan.predicted, guessed(state, plan.command))


@pytest.mark.parametrize("seed", range(8))
def test_a_budget_that_is_not_spent_changes_nothing(seed: int) -> None:
    state, target = points(seed)
    controller = CautiousController(Guessed(), LossyHopper(), NO_FAILURES)
    larger = replace(controller, settings=ControlSettings(evaluations=100_000))
    np.testing.assert_array_equal(controller(state, target).command, larger(state, target).command)


@pytest.mark.parametrize("seed", range(8))
def test_a_small_budget_still_improves_on_the_guess(seed: int) -> None:
    state, target = points(seed)
    sure = LossyHopper()
    plan = CautiousController(sure, sure, NO_FAILURES, ControlSettings(evaluations=60))(state, target)
    before = sure(state, sure.space.command_centre) - target
    after = plan.predicted - target
    assert np.linalg.norm(after / sure.space.state_scale) <= np.linalg.norm(before / sure.space.state_scale)


def test_a_spent_budget_makes_every_step_fail_and_costs_no_evaluation() -> None:
    counted = CountingMap(LossyHopper())
    limited = BudgetedMap(counted, EvaluationBudget(10))
    state, command = counted.space.state_centre, counted.space.command_centre
    np.testing.assert_array_equal(limited.jacobian(state, command), difference_jacobian(LossyHopper(), state, command))
    assert counted.cost == 8
    assert limited.evaluate(np.tile(state, (3, 1)), command).status.tolist() == [StepStatus.INVALID] * 3
    assert np.isnan(limited.jacobian(state, command)).all()
    assert counted.cost == 8
    np.testing.assert_array_equal(limited(state, command), LossyHopper()(state, command))
    assert limited.budget.remaining == 1


def test_too_small_a_budget_is_refused() -> None:
    with pytest.raises(ValueError, match="evaluations"):
        ControlSettings(evaluations=10)


class FailsOutside(LossyHopper):
    """A robot that steps only with small forces, so that it falls with a command that another state wanted."""

    def status(self, state: Array, command: Array) -> Codes:
        status = np.where(np.abs(command[..., 0]) > 6, StepStatus.FELL, StepStatus.OK)
        return np.broadcast_to(status, np.broadcast_shapes(state.shape[:-1], command.shape[:-1]))


@pytest.mark.parametrize("evaluations", [60, 100, 2000])
def test_a_search_whose_start_makes_no_step_begins_again_in_the_middle(evaluations: int) -> None:
    hopper = FailsOutside()
    state, target = np.array([0.2, 0.58]), np.array([0.22, 0.57])
    controller = CautiousController(hopper, hopper, NO_FAILURES, ControlSettings(evaluations=evaluations))
    plan = controller(state, target, guess=np.array([14.0, 0.0]))
    np.testing.assert_allclose(plan.predicted, target, atol=1e-6)
