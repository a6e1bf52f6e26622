"""The correctors in Python and C plan what a run plans, of a robot in which the command of the step before acts on."""

from collections.abc import Callable

import numpy as np
import pytest

from stepgap.control.cautious_controller import CautiousController
from stepgap.cure.lesson import Lesson
from stepgap.export.controller.model_document import model_document
from stepgap.export.controller.portable_controller import PortableController, portable_form
from stepgap.export.controller.step_filter import UNCORRECTED, StepFilter
from stepgap.learning.steps import LoggedStep
from stepgap.step import StepRecord, StepStatus
from tests.cure.drives import DRIFT
from tests.export.controller.test_c_source import COMPILER, Compiled
from tests.export.controller.test_c_source import compile_in as compile_in  # fixture

SAME = 1e-8
"""Commands differ by less [half ranges]."""


@pytest.fixture(scope="module")
def controller(minute: Lesson) -> PortableController:
    return portable_form(minute.learner, minute.control, np.random.default_rng(0), {}, "a log")


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
def test_in_a_closed_loop_python_and_c_are_the_run(
    minute: Lesson, controller: PortableController, compile_in: Callable[..., Compiled]
) -> None:
    """Some targets are beyond reach, and some states are missing, of which a run has none: there two are compared."""
    space, rng = minute.space, np.random.default_rng(1)
    python, code, learner = StepFilter(model_document(controller)), compile_in(controller), minute.learner
    state, before = np.zeros(3), np.zeros(3)
    is_run, target = True, np.zeros(3)
    away = list[float]()
    for number in range(36):
        if number % 4 == 0:
            target = rng.uniform([-0.1, -0.2, -0.4], [0.9, 0.25, 0.5])
        measured = None if number in (20, 27) else state
        plan = python.plan(measured, target, before)
        status, command, predicted, _ = planned_by_c(code, measured, target, before)
        assert status == plan.status == (UNCORRECTED if measured is None else StepStatus.OK)
        away.append(float(np.abs((command - plan.command) / space.command_scale).max()))
        is_run = is_run and measured is not None
        if is_run and number:
            step_map = learner.step_map()
            run = CautiousController(step_map, learner.nominal, learner.failures, minute.control, previous=before)
            expected = run(state, target, before)
            away.append(float(np.abs((expected.command - plan.command) / space.command_scale).max()))
            np.testing.assert_allclose(predicted, expected.predicted, atol=1e-7)
        next_state = 0.1 * state + 0.4 * plan.command + 0.3 * before + DRIFT + 0.01 * rng.standard_normal(3)
        given = measured, plan.command, next_state
        python.update(*given)
        code.call("filter_update", code.filter, *(None if part is None else code.array(part) for part in given), np.nan)
        record = StepRecord(state, plan.command, plan.command, next_state, StepStatus.OK)
        learner = learner.after(LoggedStep(2, number + 1, target, next_state, np.zeros(3), record))
        state, before = next_state, plan.command
    assert len(away) > 36 + 18
    assert max(away) < SAME


def planned_by_c(code: Compiled, state: np.ndarray | None, target: np.ndarray, before: np.ndarray) -> tuple:
    """Status, command, prediction and standard deviation."""
    found = code.array(code.m), code.array(code.n), code.array(code.n)
    given = None if state is None else code.array(state)
    status = code.call("plan", code.filter, given, code.array(target), code.array(before), float("nan"), *found)
    return status, *found


def test_the_command_before_is_that_which_was_sent_also_if_the_step_was_not_learned(
    controller: PortableController,
) -> None:
    python = StepFilter(model_document(controller))
    state, target = np.array([0.3, 0.0, 0.0]), np.array([0.4, 0.0, 0.0])
    slow, fast = (python.plan(state, target, np.array([speed, 0.0, 0.0])) for speed in (0.3, 0.6))
    assert slow.command[0] > fast.command[0] + 0.02, "what was told before still acts"
