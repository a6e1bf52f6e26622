import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.hardware.realtime.board import LONGEST_MESSAGE, Board, Request, StepEnd
from stepgap.plants.tick_control import FinishedStep
from stepgap.plants.ticks.rig_state import RigState
from stepgap.step import StepStatus

STATES, COMMANDS, CONTEXT = 3, 2, 2


def vectors(size):
    return st.lists(st.floats(), min_size=size, max_size=size)


@pytest.fixture(scope="module")
def boards():
    """The two ends of a board."""
    here = Board.create(STATES, COMMANDS, CONTEXT)
    there = Board.attach(here.name)
    yield here, there
    there.close()
    here.close()
    here.unlink()


def test_a_new_board_has_no_request_and_no_command():
    board = Board.create(STATES, COMMANDS, CONTEXT)
    try:
        assert (board.request, board.state, board.emergency_stop) == (Request.NOTHING, RigState.OFF, False)
        assert all(board.command(number) is None and board.finished(number) is None for number in range(3))
        assert (board.message, board.ticks, board.missed_ticks) == ("", 0, 0)
        assert board.evidence == ()
    finally:
        board.close()
        board.unlink()


@given(
    st.integers(0, 2**31),
    vectors(STATES),
    vectors(COMMANDS),
    vectors(COMMANDS),
    vectors(CONTEXT),
    st.sampled_from(StepStatus),
)
def test_a_posted_message_is_read_under_its_number_only(boards, number, state, command, lost, context, status):
    here, there = boards
    here.post_command(number, command)
    np.testing.assert_array_equal(there.command(number), command)
    assert there.command(number + 1) is None
    there.post_step(number, StepEnd(FinishedStep(np.array(state), np.array(command), np.array(lost), context), status))
    found = here.finished(number)
    assert found is not None
    for value, given_value in zip(found.result, (state, command, lost, context), strict=True):
        np.testing.assert_array_equal(value, given_value)
    assert found.status == status
    assert here.finished(number + 1) is None
    here.evidence = tuple(state)
    np.testing.assert_array_equal(there.evidence, state)
    here.evidence = ()
    assert there.evidence == ()


@pytest.mark.parametrize("wrong", [(), (1.0,), (1.0,) * (COMMANDS + 1)])
def test_a_command_of_another_length_is_never_read(boards, wrong):
    here, there = boards
    with pytest.raises(ValueError, match="zip"):
        here.post_command(5, wrong)
    assert there.command(5) is None


@given(st.text(st.characters()))
def test_messages_of_any_length_arrive(boards, text):
    here, there = boards
    there.message = text
    encoded = text.encode("utf-8", "replace")
    assert here.message.encode("utf-8", "replace")[: LONGEST_MESSAGE - 3] == encoded[: LONGEST_MESSAGE - 3]


def test_states_requests_and_counts_arrive(boards):
    here, there = boards
    there.state = RigState.STAND
    here.request = Request.STOP
    here.stop_at_once()
    there.count_tick(2)
    there.count_tick(0)
    assert (here.state, there.request, there.emergency_stop) == (RigState.STAND, Request.STOP, True)
    assert (here.ticks, here.missed_ticks) == (2, 2)
