"""Times of ticks and of the frames between them."""

import numpy as np
import pytest

from stepgap.hardware.realtime.pace import TickClock

TICK = 1e-3


@pytest.mark.parametrize("work", [0.0, 2e-5, 1.2e-4])
def test_frames_have_equal_distances_although_the_first_one_waits_for_the_work_of_its_tick(work: float) -> None:
    clock, sent = TickClock(TICK), []
    for _ in range(50):
        worked = clock.begin() + work
        sent += [worked, *clock.frame_times(4, worked)]
    np.testing.assert_allclose(np.diff(sent), TICK / 4, rtol=1e-9)


def test_a_slow_tick_hardly_moves_the_frames_after_it() -> None:
    clock = TickClock(TICK)

    def distances(work: float) -> np.ndarray:
        begun = clock.begin()
        return np.array(clock.frame_times(4, begun + work)) - begun

    usual = [distances(2e-5) for _ in range(200)][-1]
    np.testing.assert_allclose(usual, [2.7e-4, 5.2e-4, 7.7e-4], atol=1e-9)
    np.testing.assert_allclose(distances(5e-4), usual, atol=2.2e-6)


def test_frames_follow_a_tick_that_has_shifted_all_later_ones() -> None:
    clock = TickClock(TICK)
    clock.begin()
    begun = clock.begin(late=1.5e-3)
    assert clock.frame_times(2, begun) == pytest.approx([begun + TICK / 2])
    assert clock.frame_times(1, begun) == []
