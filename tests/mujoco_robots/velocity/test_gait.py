"""The period of a gait from velocities alone, against signals and a gait whose period is known."""

from dataclasses import replace

import numpy as np
import pytest

from stepgap.mujoco_robots.velocity.gait import Gait, gait_of, gait_period
from stepgap.mujoco_robots.velocity.robot import TrottingRobot
from stepgap.mujoco_robots.velocity.walking_robot import Walk, gait_finding, measured_walk
from stepgap.step import Array


def swaying(period: float, noise: float) -> Array:
    """Velocities of eight walks, which sway with the period, forward mostly with half of it, as in walking."""
    rng = np.random.default_rng(3)
    time = 0.02 * np.arange(150) + rng.uniform(0, 1, (8, 1))
    angle = 2 * np.pi * time / period
    forward = 0.4 + 0.05 * np.sin(2 * angle) + 0.02 * np.sin(angle)
    sways = np.stack([forward, 0.1 * np.cos(angle), 0.2 * np.sin(angle + 1)], axis=-1)
    return sways + noise * rng.standard_normal(sways.shape)


@pytest.mark.parametrize("period", [0.667, 0.39, 1.1])
def test_the_period_of_a_swaying_body_is_found_and_not_its_half(period: float) -> None:
    found, height = gait_period(swaying(period, noise=0.02), 0.02)
    assert found == pytest.approx(period, rel=0.01)
    assert 0.7 < height <= 1


def test_noise_and_a_body_that_does_not_sway_have_no_strict_period() -> None:
    for velocities in (np.random.default_rng(0).standard_normal((8, 150, 3)), np.full((8, 150, 3), 0.4)):
        assert gait_period(velocities, 0.02)[1] < 0.3


def test_a_step_is_whole_where_it_is_a_multiple_of_a_strict_period() -> None:
    strict = Gait(0.25, 0.9, (0.3,) * 3, (0.0,) * 3)
    assert strict.whole_steps(0.5) == 0.5
    assert strict.whole_steps(0.1) == 0.25
    assert [strict.fits(seconds) for seconds in (0.5, 0.25, 0.375, 0.125, 0.005)] == [True, True, False, False, False]
    loose = replace(strict, height=0.3)
    assert loose.fits(0.375)
    assert loose.whole_steps(0.4) == 0.4


def test_the_trot_repeats_itself_with_its_period_and_follows_within_a_step() -> None:
    robot = TrottingRobot()
    walk = measured_walk(robot)
    assert walk is not None
    gait = gait_of(walk, robot.walk.seconds)
    assert gait.period == pytest.approx(robot.gait.period, rel=0.005)
    assert gait.height > 0.8
    assert all(0.1 < seconds < 0.5 for seconds in gait.response)
    assert max(gait.scatter) < 0.1 * max(gait_of(walk, 0.6).scatter), "a mean of whole periods does not sway"
    words = gait.in_words(robot.space)
    assert words.startswith("It repeats every 0.25 s (autocorrelation of its velocities 0.")


def test_a_step_that_is_no_whole_number_of_periods_is_wrong_and_the_right_one_is_said() -> None:
    finding = gait_finding(TrottingRobot(walk=Walk(seconds=0.35)))
    assert (finding.part, finding.right) == ("gait", False)
    assert "A step of 0.35 s is 1.40 periods" in finding.sentence
    assert finding.sentence.endswith("Set walk.seconds = 0.2502.")


def test_a_robot_that_falls_has_no_gait() -> None:
    finding = gait_finding(TrottingRobot(walk=Walk(fall_height=0.4)))
    assert not finding.right
    assert finding.sentence.startswith("The model falls at constant commands")
