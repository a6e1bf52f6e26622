"""What rigs on any bus share: lost answers, and the torque that a drive reports against its commands."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.hardware.bus_rig import LOST_SHARE, MOST_WRONG, TORQUE_SHARE, Losses, TorqueWatch


def readings_until_wrong(commands, actual, tolerance=50.0, readings=5):
    """Number of readings until a drive is at fault whose torque depends on all commands so far; None if it never is."""
    watch = TorqueWatch(tolerance, readings)
    for number, command in enumerate(commands):
        watch.command(command)
        if watch.reading(actual(commands[: number + 1])):
            return number + 1
    return None


@given(
    st.lists(st.integers(-2000, 2000), min_size=1, max_size=60),
    st.integers(0, 4),
    st.floats(0.3, 1.0),
    st.floats(-0.1, 0.1),
)
def test_a_drive_with_delay_and_lag_is_never_wrong(commands, delay, quick, error):
    """Its torque is a mean of commands of that time, with an error of scale."""

    def actual(sent):
        late = [0, *sent][max(0, len(sent) - delay)]
        before = [0, *sent][max(0, len(sent) - min(4, delay + 1))]
        return (quick * late + (1 - quick) * before) * (1 + error)

    assert readings_until_wrong(commands, actual, readings=6) is None


@pytest.mark.parametrize("actual", [lambda _: 2000, lambda _: -900, lambda sent: -sent[-1], lambda _: 0])
def test_a_drive_that_runs_away_turns_the_wrong_way_or_is_dead_is_found_in_a_few_readings(actual):
    found = readings_until_wrong([300] * 40, actual, readings=5)
    assert found is not None
    assert found <= 5 + MOST_WRONG


def test_a_torque_that_is_kept_is_wrong_when_the_commands_have_left_it():
    commands = [300] * 20 + [-300] * 20
    found = readings_until_wrong(commands, lambda _: 300, readings=5)
    assert found is not None
    assert 20 + 5 <= found <= 20 + 5 + MOST_WRONG


def test_single_wrong_readings_are_noise():
    watch = TorqueWatch(50.0, 5)
    for number in range(100):
        watch.command(300.0)
        assert not watch.reading(2000.0 if number % MOST_WRONG else 300.0)


def test_small_differences_are_allowed():
    watch, rng = TorqueWatch(50.0, 2), np.random.default_rng(0)
    for _ in range(1000):
        watch.command(400.0)
        assert not watch.reading(400.0 + rng.uniform(-1, 1) * (50.0 + 400.0 * TORQUE_SHARE))


def test_before_the_first_command_and_after_a_restart_nothing_is_wrong():
    watch = TorqueWatch(50.0, 5)
    assert not any(watch.reading(5000.0) for _ in range(10))
    watch.command(0.0)
    assert [watch.reading(5000.0) for _ in range(3)][-1]
    watch.restart()
    assert not watch.reading(5000.0)


@pytest.mark.parametrize(("lost_of", "share"), [(2, 0.5), (3, 2 / 3)])
def test_a_device_that_answers_seldom_is_absent(lost_of, share):
    losses = Losses(2)
    reasons = [losses.missed() if tick % lost_of else losses.received() for tick in range(200)]
    first = next(tick for tick, reason in enumerate(reasons) if reason)
    assert 1 - share**0.5 < first / 50 < 2
    assert str(reasons[first]).endswith("% of the last ticks")


@given(st.integers(0, 2**32 - 1))
def test_a_twentieth_of_lost_ticks_is_tolerated(seed):
    losses = Losses(5)
    for is_lost in np.random.default_rng(seed).random(2000) < LOST_SHARE / 6:
        assert not is_lost or not losses.missed() or losses.in_a_row > 5
        if not is_lost:
            losses.received()


def test_too_many_lost_ticks_in_a_row_are_a_fault():
    losses = Losses(2)
    assert [losses.missed() for _ in range(3)] == ["", "", "3 ticks in a row"]
    losses.restart()
    assert losses.missed() == ""
