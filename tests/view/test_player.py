"""The player advances as requested, and never beyond the known hops."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.view.player import Player


def lasting(seconds: float):
    return lambda number: seconds


def test_time_advances_through_the_hops() -> None:
    player = Player()
    player.advance(1.25, 10, lasting(0.5))
    assert (player.step, player.share) == (2, pytest.approx(0.5))
    player.speed = 4.0
    player.advance(0.25, 10, lasting(0.5))
    assert (player.step, player.share) == (4, pytest.approx(0.5))


@settings(deadline=None)
@given(st.lists(st.floats(0, 3), max_size=20), st.integers(1, 6))
def test_it_stops_at_the_last_known_hop(times: list[float], count: int) -> None:
    player = Player()
    for time in times:
        player.advance(time, count, lasting(0.5))
    assert 0 <= player.step < count
    assert 0 <= player.share <= 1
    assert player.step + player.share == pytest.approx(min(count, sum(times) / 0.5), abs=1e-6)


def test_it_waits_for_motion_that_is_being_computed() -> None:
    player = Player()
    player.advance(5.0, 4, lambda number: 0.5 if number < 2 else None)
    assert (player.step, player.share) == (1, 1.0)
    player.advance(0.25, 4, lasting(0.5))
    assert player.step == 2


def test_a_pause_stops_time() -> None:
    player = Player()
    player.toggle()
    player.advance(1.0, 4, lasting(0.5))
    assert (player.step, player.share) == (0, 0.0)
    player.toggle()
    player.advance(0.25, 4, lasting(0.5))
    assert player.share == pytest.approx(0.5)


def test_one_step_plays_to_the_end_of_a_hop_and_pauses() -> None:
    player = Player(playing=False)
    for hop in range(3):
        player.one_step(3)
        player.advance(10.0, 3, lasting(0.5))
        assert (player.step, player.share, player.playing) == (hop, 1.0, False)


def test_following_skips_to_the_newest_hop() -> None:
    player = Player(follow=True)
    player.advance(0.5, 8, lasting(0.5))
    assert player.step == 7


def test_a_choice_of_the_user_ends_following() -> None:
    player = Player(follow=True)
    player.show(3)
    player.advance(0.6, 8, lasting(0.5))
    assert (player.step, player.follow) == (4, False)
