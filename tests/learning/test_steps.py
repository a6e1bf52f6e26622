"""The record of steps in memory."""

import math
from dataclasses import replace

import numpy as np

from stepgap.learning.steps import LoggedStep, Steps, column_names
from stepgap.step import ContextQuantity, Quantity, StepRecord, StepSpace, StepStatus
from tests.control.maps import YAW

SPACE = StepSpace(
    (Quantity("speed", "m/s", 0.0, 0.4), Quantity("height", "m", 0.5, 0.6)),
    (Quantity("fx", "N", -15, 15), Quantity("fy", "N", -20, 20)),
    (YAW,),
)
NO_STATE = np.full(2, np.nan)


def step(iteration: int = 0, number: int = 1, status: StepStatus = StepStatus.OK, offset: float = 0.0) -> LoggedStep:
    next_state = np.array([0.1 + 0.01 * number + offset, 0.55]) if status == StepStatus.OK else NO_STATE
    record = StepRecord(np.array([0.1, 0.55]), np.array([1.0, -2.0]), np.array([0.5, -2.0]), next_state, status)
    return LoggedStep(iteration, number, np.array([0.2, 0.58]), np.array([0.2, 0.58]), np.zeros(2), record)


def test_the_phase_of_a_step_is_where_the_one_before_ended() -> None:
    first = [step(), step(number=2), step(number=3)]
    yaws = [0.5, math.nan, 7.0]
    known = [replace(s, record=replace(s.record, context={"yaw": yaw})) for s, yaw in zip(first, yaws, strict=True)]
    np.testing.assert_array_equal(Steps(SPACE, [*known, step(1, 1)]).phase, [math.nan, 0.5, math.nan, math.nan])
    assert Steps(SPACE).phase.shape == (0,)
    left_out = Steps(SPACE, [known[0], known[2]])
    np.testing.assert_array_equal(left_out.phase, [math.nan, math.nan])


def test_the_log_by_columns() -> None:
    log = Steps(SPACE, [step(), step(number=2, status=StepStatus.FELL), step(1, 1)])
    assert (len(log), log.failed_steps, log.iterations) == (3, 1, [0, 1])
    assert len(log.completed()) == 2
    assert len(log.of_iteration(1)) == 1
    for column in (log.state, log.applied, log.next_state, log.target, log.predicted, log.std):
        assert column.shape == (3, 2)
    assert Steps(SPACE).next_state.shape == (0, 2)


def test_steps_are_appended_without_copying_those_before() -> None:
    log, copies = Steps(SPACE), 0
    for number in range(1, 501):
        longer = log + [step(number=number)]  # noqa: RUF005 they are no list
        copies += not np.shares_memory(longer.rows, log.rows)
        log = longer
    assert copies <= 5
    np.testing.assert_array_equal(log.number, np.arange(1, 501))


def test_logs_that_continue_the_same_steps_do_not_disturb_each_other() -> None:
    begun = Steps(SPACE) + [step(), step(number=2)]  # noqa: RUF005 they are no list
    one, other = begun + [step(number=3)], begun + [step(number=3, offset=1.0)]  # noqa: RUF005 they are no list
    longer = one + other
    assert begun.number.tolist() == [1, 2]
    np.testing.assert_allclose(one.next_state[:, 0], [0.11, 0.12, 0.13])
    np.testing.assert_allclose(other.next_state[:, 0], [0.11, 0.12, 1.13])
    np.testing.assert_allclose(longer.next_state[:, 0], [0.11, 0.12, 0.13, 0.11, 0.12, 1.13])


def test_a_row_is_the_step_that_was_added() -> None:
    wanted = replace(
        step(number=2), record=replace(step().record, context={"yaw": 0.3}, requested=np.array([3.0, 4.0]))
    )
    (found,) = Steps(SPACE, [wanted])
    assert (found.iteration, found.step, found.record.status) == (0, 2, StepStatus.OK)
    assert found.record.context == {"yaw": 0.3}
    for name in ("target", "predicted", "std"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))
    for name in ("state", "command", "requested", "applied", "next_state", "true_next_state"):
        np.testing.assert_array_equal(getattr(found.record, name), getattr(wanted.record, name))


def test_what_the_columns_do_not_give_is_unknown() -> None:
    steps = Steps.of_columns(SPACE, state=np.ones((3, 2)), command=np.full((3, 2), 2.0), target=np.zeros(2))
    np.testing.assert_array_equal(steps.requested, steps.command)
    np.testing.assert_array_equal(steps.applied, steps.command)
    assert (steps.iteration.tolist(), steps.number.tolist(), steps.failed_steps) == ([0, 0, 0], [1, 2, 3], 0)
    for column in (steps.next_state, steps.true_next_state, steps.predicted, steps.std, steps.context):
        assert np.isnan(column).all()


def test_the_context_is_that_of_the_space() -> None:
    """Numbers under other names are left out, and quantities that were not measured are unknown."""
    wind, measured = (
        ContextQuantity("wind", "m/s"),
        replace(step(), record=replace(step().record, context={"yaw": 0.3})),
    )
    steps = Steps(replace(SPACE, context=(wind, YAW)), Steps(SPACE, [measured]))
    np.testing.assert_array_equal(steps.context, [[math.nan, 0.3]])
    assert steps.in_space(replace(SPACE, context=())).context.shape == (1, 0)


def test_steps_are_indexed_and_described_in_a_line() -> None:
    log = Steps(SPACE, [step(), step(number=2, status=StepStatus.FELL), step(1, 1)])
    assert (log[-1].iteration, log[1].record.status, log[1:].iterations) == (1, StepStatus.FELL, [0, 1])
    assert len(log[log.status == StepStatus.OK]) == 2
    assert repr(log).startswith("<3 steps (2 of deployment 0, 1 of deployment 1): state ")
    assert repr(Steps(SPACE)).startswith("<0 steps: ")
    assert log._repr_html_().count("<tr>") == 1 + 3


def test_the_columns_are_those_of_the_file() -> None:
    log = Steps(SPACE, [step(), step(number=2, status=StepStatus.FELL)])
    columns = log.to_dict()
    assert list(columns) == column_names(SPACE)
    assert columns["status"].tolist() == ["ok", "fell"]
    np.testing.assert_array_equal(columns["step"], [1, 2])
    for row, name in enumerate(SPACE.state_names):
        np.testing.assert_array_equal(columns[f"next_{name}"], log.next_state[:, row])
    assert all(len(values) == 0 for values in Steps(SPACE).to_dict().values())
