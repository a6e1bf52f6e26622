import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.plants.realtime.board import LONGEST_MESSAGE, Board, FinishedHop, Request
from stepgap.plants.ticks.rig_state import RigState
from stepgap.step import StepStatus


@pytest.fixture(scope="module")
def boards():
    """The two ends of a board."""
    here = Board.create()
    there = Board.attach(here.name)
    yield here, there
    there.close()
    here.close()
    here.unlink()


def test_a_new_board_has_no_request_and_no_command():
    board = Board.create()
    try:
        assert (board.request, board.state, board.emergency_stop) == (Request.NOTHING, RigState.OFF, False)
        assert all(board.command(number) is None and board.hop(number) is None for number in range(3))
        assert (board.message, board.ticks, board.missed_ticks, board.worst_lateness) == ("", 0, 0, 0.0)
    finally:
        board.close()
        board.unlink()


@given(st.integers(0, 2**31), st.floats(), st.floats(), st.floats())
def test_a_posted_message_is_read_under_its_number_only(boards, number, fx, fy, yaw):
    here, there = boards
    here.post_command(number, fx, fy)
    np.testing.assert_array_equal(there.command(number), (fx, fy))
    assert there.command(number + 1) is None
    hop = FinishedHop(number, fx, fy, -fy, -fx, 2 * fx, 3 * fy, yaw, StepStatus.NO_APEX)
    there.post_hop(hop)
    np.testing.assert_array_equal(here.hop(number), hop)
    assert here.hop(number + 1) is None


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
    there.count_tick(2e-3, 2)
    there.count_tick(1e-6, 0)
    assert (here.state, there.request, there.emergency_stop) == (RigState.STAND, Request.STOP, True)
    assert (here.ticks, here.missed_ticks, here.worst_lateness) == (2, 2, 2e-3)
