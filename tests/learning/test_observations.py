from dataclasses import replace

import numpy as np
import pytest

from stepgap.learning.learner import Learner
from stepgap.learning.observations import Observations, next_history, observe
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import TAINTED, LoggedStep, Steps
from stepgap.step import Array, StepRecord, StepStatus
from tests.learning.test_corrected_map import NOMINAL, SPACE, actual, apexes


def log_of(*deployments: int, fallen: bool = False) -> Steps:
    """Deployments with the given numbers of steps; the last step of the last one may be a fall."""
    log, (state, command) = Steps(SPACE), apexes(sum(deployments), seed=1)
    for iteration, size in enumerate(deployments):
        for number in range(1, size + 1):
            row = len(log)
            fell = fallen and row == len(state) - 1
            after, status = actual(state[row], command[row]), StepStatus.OK
            after, status = (np.full(2, np.nan), StepStatus.FELL) if fell else (after, status)
            record = StepRecord(state[row], 2 * command[row], command[row] / 2, after, status, requested=command[row])
            log += [LoggedStep(iteration, number, state[row], state[row], np.zeros(2), record)]
    return log


def history_of(observations: Observations) -> Array:
    assert observations.history is not None
    return observations.history


def test_errors_are_those_of_the_nominal_map_at_commands_requested() -> None:
    log = log_of(5, 4, fallen=True)
    observations = observe(log, NOMINAL)
    done = [logged.record for logged in log.completed()][:-1]  # the fall makes the state before it doubtful
    assert len(observations) == 7
    assert observations.space is SPACE
    np.testing.assert_array_equal(observations.state, [record.state for record in done])
    np.testing.assert_array_equal(observations.command, [record.requested for record in done])
    np.testing.assert_array_equal(observations.error, [r.next_state - NOMINAL(r.state, r.requested) for r in done])


def test_history_is_the_number_of_steps_before() -> None:
    np.testing.assert_array_equal(history_of(observe(log_of(4, 3), NOMINAL)), np.arange(7.0)[:, None])


def test_the_first_step_of_a_warm_start_has_no_history() -> None:
    """Steps that were known before are those of deployments before number 0."""
    for first in (-1, -2):
        known = Steps(SPACE, [replace(step, iteration=step.iteration + first) for step in log_of(4, 3)])
        np.testing.assert_array_equal(history_of(observe(known, NOMINAL)), history_of(observe(log_of(4, 3), NOMINAL)))


def test_the_next_step_gets_the_history_that_it_will_be_learned_with() -> None:
    log = log_of(4, 3)
    history = history_of(observe(log, NOMINAL))
    steps = list(log)
    for row, logged in enumerate(steps):
        before = Steps(SPACE, steps[:row])
        np.testing.assert_allclose(next_history(before, SPACE, logged.iteration), history[row], rtol=1e-12)


def test_a_step_that_fails_on_the_nominal_map_has_no_error() -> None:
    log = log_of(3)
    steps = list(log)
    fast = StepRecord(np.array([0.35, 0.58]), np.zeros(1), np.zeros(1), np.array([0.2, 0.58]), StepStatus.OK)
    steps[1] = LoggedStep(0, 2, steps[1].target, steps[1].predicted, np.zeros(2), fast)
    observations = observe(Steps(SPACE, steps), NOMINAL)
    np.testing.assert_array_equal(observations.state, [steps[0].record.state, steps[2].record.state])
    np.testing.assert_array_equal(history_of(observations)[1], [2])
    np.testing.assert_array_equal(next_history(Steps(SPACE, steps[:2]), SPACE, 0), history_of(observations)[1])


def with_status(log: Steps, *statuses: tuple[int, StepStatus]) -> Steps:
    """The log with other statuses in some rows, whose steps then have no next state."""
    steps = list(log)
    for row, status in statuses:
        record = replace(steps[row].record, next_state=np.full(2, np.nan), status=status)
        steps[row] = replace(steps[row], record=record)
    return Steps(SPACE, steps)


def test_a_step_with_a_doubtful_sensor_and_those_before_it_are_not_learned_from() -> None:
    """Nor is it a failure that a controller avoids."""
    marked = with_status(log_of(37, 2), (36, StepStatus.DOUBTFUL))
    assert np.flatnonzero(marked.doubtful).tolist() == [*range(36 - TAINTED[StepStatus.DOUBTFUL], 37)]
    np.testing.assert_array_equal(observe(marked, NOMINAL).state, marked.state[[*range(6), 37, 38]])
    learner, last = Learner.start(NOMINAL, marked, LearningSettings(), 3), list(marked)[3]
    assert len(learner.failures) == 0
    assert len(learner.after(replace(last, iteration=3, step=1)).failures) == 0


def test_steps_of_earlier_deployments_of_the_run_are_doubtful_too() -> None:
    """A sensor that was wrong a little is found in the third deployment, and the beliefs forget the ones before."""
    marked = with_status(log_of(20, 12, 12, 4), (40, StepStatus.DOUBTFUL))
    assert np.flatnonzero(marked.doubtful).tolist() == [*range(40 - TAINTED[StepStatus.DOUBTFUL], 41)]
    apart = marked.with_columns(iteration=np.where(marked.iteration < 1, -4, marked.iteration))
    assert np.flatnonzero(apart.doubtful).tolist() == [*range(20, 41)]  # another run


def test_beliefs_do_not_contain_what_a_later_deployment_made_doubtful() -> None:
    right = with_status(log_of(12, 12, 12), (20, StepStatus.DOUBTFUL))
    wrong = right.with_columns(next_state=np.where(right.doubtful[:, None], right.next_state + 0.5, right.next_state))
    settings = LearningSettings(residual="posterior")
    ours, others = (Learner.start(NOMINAL, steps, settings, 3).step_map() for steps in (right, wrong))
    points = apexes(5, seed=2)
    np.testing.assert_array_equal(ours.evaluate(*points).next_state, others.evaluate(*points).next_state)


def test_a_fall_makes_the_step_before_it_doubtful_and_is_avoided() -> None:
    marked = with_status(log_of(3, 4), (3, StepStatus.FELL), (6, StepStatus.FELL))
    assert np.flatnonzero(marked.doubtful).tolist() == [5]
    np.testing.assert_array_equal(observe(marked, NOMINAL).state, marked.state[[0, 1, 2, 4]])
    assert len(Learner.start(NOMINAL, marked, LearningSettings(), 3).failures) == 2


def test_a_stop_for_another_reason_makes_no_step_doubtful() -> None:
    assert not with_status(log_of(4), (3, StepStatus.STOPPED)).doubtful.any()
    assert not with_status(log_of(4), (3, StepStatus.NO_APEX)).doubtful.any()


def test_an_empty_log_has_no_observations() -> None:
    assert len(observe(Steps(SPACE), NOMINAL)) == 0
    np.testing.assert_array_equal(next_history(Steps(SPACE), SPACE, 0), np.zeros(1))


class TestRefused:
    DATA = (np.zeros((4, 2)), np.zeros((4, 1)), np.zeros((4, 2)), np.zeros((4, 1)))
    NAMES = ("state", "command", "error", "history")

    @pytest.mark.parametrize("argument", range(4))
    @pytest.mark.parametrize("bad", [np.nan, np.inf])
    def test_a_row_that_is_not_finite(self, argument: int, bad: float) -> None:
        data = [array.copy() for array in self.DATA]
        data[argument][3, 0] = bad
        with pytest.raises(ValueError, match=f"^{self.NAMES[argument]} must be finite, but row 3"):
            Observations(SPACE, **dict(zip(self.NAMES, data, strict=True)))

    @pytest.mark.parametrize("argument", range(4))
    def test_a_wrong_number_of_columns_or_rows(self, argument: int) -> None:
        named, right = self.NAMES[argument], self.DATA[argument]

        def observed_with(wrong: Array) -> Observations:
            return replace(Observations(SPACE, *self.DATA), **{named: wrong})

        for wrong in (right[:, 1:], right[0]):
            with pytest.raises(ValueError, match=f"^{named} must have the columns"):
                observed_with(wrong)
        with pytest.raises(ValueError, match="must have one length"):
            observed_with(right[1:])
