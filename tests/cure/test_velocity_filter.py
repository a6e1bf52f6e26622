"""The correction on the robot: whatever is wrong with the odometry, the command is the plain one within a step."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from stepgap.cure.velocity_filter import FilterSettings, VelocityFilter
from stepgap.step import Array

SECONDS, TICK = 0.5, 0.02
ASKED = (0.4, 0.0, 0.1)
SETTINGS = FilterSettings(seconds=SECONDS, limits=(0.8, 0.3, 0.6), jump=(0.5, 0.5, 1.0))


class Doubling:
    """A controller whose command is twice the target."""

    def __init__(self) -> None:
        self.plans: list[tuple[Array, Array, Array | None]] = []
        self.updates: list[Any] = []
        self.forgotten = 0

    def plan(self, state: Array, target: Array, before: Array | None) -> SimpleNamespace:
        self.plans.append((state, target, before))
        return SimpleNamespace(status=0, command=np.clip(2 * np.nan_to_num(target), -0.8, 0.8))

    def update(self, state: Array | None, command: Array, next_state: Array | None, **how: Any) -> None:
        self.updates.append((state, command, next_state, how))

    def forget_way(self) -> None:
        self.forgotten += 1


def walked(
    seconds: float, settings: FilterSettings = SETTINGS, wrong: Any = None, asked: Any = ASKED
) -> tuple[Doubling, VelocityFilter, list[tuple[float, float, tuple[float, ...], str]]]:
    """Walks; `wrong(time, velocity)` is the odometry, None where it is silent. Returns time, command and reason."""
    controller = Doubling()
    found, said = VelocityFilter(controller, settings), []
    rng = np.random.default_rng(0)
    for tick in range(round(seconds / TICK)):
        time = tick * TICK
        velocity = np.array([0.3, 0.0, 0.1]) + 0.01 * rng.standard_normal(3)
        seen = velocity if wrong is None else wrong(time, velocity)
        if seen is not None:
            found.odometry(time, seen)
        command = found.command(time, asked(time) if callable(asked) else asked)
        said.append((time, command[0], command, found.reason))
    return controller, found, said


def test_after_a_step_of_odometry_commands_are_corrected_once_in_a_step() -> None:
    controller, _, said = walked(2.99)
    assert said[0][1:] == (0.4, ASKED, "the odometry has too few samples in a step")
    assert said[-1][1:] == (0.8, (0.8, 0.0, 0.2), "")
    assert len(controller.plans) == 6, "of 3 s, the first half of a second has no mean velocity"
    state, target, before = controller.plans[-1]
    np.testing.assert_allclose(state, [0.3, 0.0, 0.1], atol=0.01)
    np.testing.assert_array_equal(target, ASKED)
    assert before is not None
    np.testing.assert_allclose(before, [0.8, 0.0, 0.2], atol=1e-9)
    learned = [update for update in controller.updates if update[0] is not None]
    assert len(learned) == len(controller.plans) - 1, "it learns from every whole step"


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (lambda time, velocity: None if time > 2 else velocity, "no odometry for 0.2 s"),
        (lambda time, velocity: velocity * (math.nan if time > 2 else 1), "the odometry is no number"),
        (lambda time, velocity: np.array([0.31, 0.0, 0.1]) if time > 2 else velocity, "repeats the same numbers"),
        (lambda time, velocity: velocity + 2.0 * (time > 2 and round(time / TICK) % 5 == 0), "jumps"),
        (lambda time, velocity: velocity * (math.inf if time > 2 else 1), "the odometry is no number"),
    ],
    ids=["silent", "nan", "frozen", "jumping", "infinite"],
)
def test_wrong_odometry_gives_the_plain_command_within_a_step_and_a_reason(wrong: Any, reason: str) -> None:
    _, _, said = walked(4.0, wrong=wrong)
    before = [row for row in said if 1.0 < row[0] <= 2.0]
    after = [row for row in said if row[0] > 2.0 + SECONDS]
    assert all(row[1] == 0.8 and not row[3] for row in before)
    assert all(row[2] == ASKED for row in after)
    assert all(reason in row[3] for row in after)


def test_it_recovers_when_odometry_is_right_again() -> None:
    _, _, said = walked(6.0, wrong=lambda time, velocity: None if 2 < time < 3 else velocity)
    assert all(not row[3] for row in said if row[0] > 3 + 2 * SECONDS)


def test_a_new_velocity_is_planned_for_at_once_and_a_changing_one_not_in_every_tick() -> None:
    controller, _, said = walked(3.0, asked=lambda time: (0.4, 0.0, 0.0) if time < 2.1 else (0.0, 0.0, 0.0))
    at_change = next(row for row in said if row[0] >= 2.1 - 1e-9)
    assert at_change[1] == 0.0
    (cut,) = (update[3]["part"] for update in controller.updates if update[0] is None and update[2] is not None)
    assert 0 < cut < 1, "a step was cut short"
    joystick, _, moving = walked(3.0, asked=lambda time: (0.1 * time, 0.0, 0.0))
    assert len(joystick.plans) <= 1 + 3 / SETTINGS.again
    commands = np.array([row[1] for row in moving if row[0] > 1])
    assert np.abs(np.diff(commands)).max() < 0.1 * 2 * SETTINGS.again


def test_nothing_is_corrected_that_is_turned_off_beyond_limits_or_no_number() -> None:
    found = walked(2.0)[1]
    found.is_on = False
    assert found.command(2.0, ASKED) == ASKED
    assert found.reason == "the correction is turned off"
    found.is_on = True
    assert found.command(2.02, (math.nan, 0.0, 0.0)) == (0.0, 0.0, 0.0)
    assert "the command is no number" in found.reason
    assert found.command(2.04, (9.0, -9.0, 9.0)) == (0.8, -0.3, 0.6)


def test_a_robot_that_stands_at_zero_is_told_zero_and_a_velocity_without_correction_is_passed_on() -> None:
    settings = FilterSettings(seconds=SECONDS, limits=(0.8, 0.3, 0.6), axes=(True, False, True), zero=True)
    controller, _, said = walked(3.0, settings, asked=lambda time: (0.4, 0.2, 0.0) if time < 2 else (0.0, 0.0, 0.0))
    assert next(row[2] for row in said if 1 < row[0] < 1.9) == (0.8, 0.2, 0.0)
    assert np.isnan(controller.plans[-1][1][1])
    assert said[-1][1:] == (0.0, (0.0, 0.0, 0.0), "the command is zero, at which this robot stands")


def test_how_a_step_is_followed_is_told_with_its_part_and_the_pose() -> None:
    """Also where nothing is learned; what was before a time without commands does not count."""
    controller = Doubling()
    found, pose = VelocityFilter(controller, replace(SETTINGS, learns=False)), (1.0, 2.0, 0.3)
    for tick in range(60):
        found.odometry(tick * TICK, (0.3, 0.0, 0.1 + 1e-6 * tick), pose)
        found.command(tick * TICK, ASKED)
    assert [round(update[3]["part"], 6) for update in controller.updates] == [1.0]
    assert controller.updates[0][0] is not None
    assert controller.updates[0][3]["pose"] == pose
    assert not controller.updates[0][3]["learns"]
    for tick in range(60, 200):
        found.odometry(tick * TICK, (0.3, 0.0, 0.1 + 1e-6 * tick), pose)
    forgotten = controller.forgotten
    found.command(4.0, ASKED)
    assert (len(controller.updates), controller.forgotten) == (1, forgotten + 1)
    assert not found.reason
