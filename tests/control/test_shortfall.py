"""What is short of targets is a pose where a body moves in a plane, by its velocities or as it is measured."""

import numpy as np
import pytest

from stepgap.control.shortfall import NOWHERE, Shortfall, moved
from stepgap.step import Array, Quantity, StepSpace

SECONDS = 0.5
STATE = tuple(Quantity(name, "", -1.0, 1.0) for name in ("vx", "vy", "wz"))
SPACE = StepSpace(STATE, STATE, planar_seconds=SECONDS)
AHEAD = np.array([0.4, 0.0, 0.0])


NO_POSE = np.full(3, np.nan)


def test_velocities_that_are_right_leave_nothing_behind() -> None:
    shortfall = Shortfall.start(SPACE)
    for velocity in np.random.default_rng(0).uniform(-1, 1, (20, 3)):
        shortfall = shortfall.after(velocity, velocity, NO_POSE)
    np.testing.assert_allclose(shortfall.behind, 0, atol=1e-12)


def test_a_circle_ends_where_it_began() -> None:
    pose = NOWHERE
    for _ in range(8):
        pose = moved(pose, np.array([0.3, 0.1, np.pi / 4]))
    np.testing.assert_allclose(pose, [0, 0, 2 * np.pi], atol=1e-12)


def test_what_is_behind_is_seen_from_the_body() -> None:
    """It was told to go on, turned by a right angle to the left, and stands: its way is then to the right of it."""
    shortfall = Shortfall.start(SPACE).after(AHEAD, np.array([0.0, 0.0, np.pi]), NO_POSE)
    np.testing.assert_allclose(shortfall.behind, [0.0, -0.4, -np.pi], atol=1e-12)


@pytest.mark.parametrize("zero", [NOWHERE, np.array([3.0, -2.0, 2.5])])
def test_a_measured_pose_counts_from_any_zero(zero: Array) -> None:
    """Velocities say that it goes straight on; it turns and slides, which the pose alone shows."""
    shortfall = Shortfall.start(SPACE).after(AHEAD, AHEAD, moved(zero, AHEAD * SECONDS))
    true = np.array([0.38, -0.04, 0.3])
    pose = moved(moved(zero, AHEAD * SECONDS), true * SECONDS)
    measured = shortfall.after(AHEAD, AHEAD, pose)
    expected = Shortfall.start(SPACE).after(AHEAD, true, NO_POSE).behind
    np.testing.assert_allclose(measured.behind, expected, atol=1e-12)
    unseen = shortfall.after(AHEAD, AHEAD, NO_POSE)
    np.testing.assert_allclose(unseen.behind, 0, atol=1e-12)


def test_a_heading_alone_turns_the_place_with_it() -> None:
    """The place is the sum of velocities along the measured heading."""
    shortfall = Shortfall.start(SPACE)
    for heading in (0.0, 0.2, 0.2):
        shortfall = shortfall.after(AHEAD, AHEAD, np.array([np.nan, np.nan, heading]))
    assert shortfall.pose[2] == pytest.approx(0.2)
    assert shortfall.pose[1] == pytest.approx(0.2 * np.sin(0.2))
    assert shortfall.behind[2] * SECONDS == pytest.approx(-0.2)


def test_coordinates_without_a_target_are_not_behind() -> None:
    shortfall = Shortfall.start(SPACE).after(np.array([0.0, np.nan, 0.0]), np.array([-0.1, 0.2, 0.0]), NO_POSE)
    np.testing.assert_allclose(shortfall.behind, [0.1, 0.0, 0.0], atol=1e-12)


def test_a_way_forward_that_was_lost_is_not_made_up_for() -> None:
    """A robot that stood for a step goes on beside the line by as much as it was, and not faster."""
    beside = Shortfall.start(SPACE).after(AHEAD, np.array([0.4, 0.1, 0.0]), NO_POSE)
    later = beside.after(AHEAD, np.array([0.1, 0.0, 0.0]), NO_POSE)
    np.testing.assert_allclose(later.behind, [0.0, -0.1, 0.0], atol=1e-12)


def test_a_heading_that_is_measured_late_counts_from_where_the_robot_then_is() -> None:
    shortfall = Shortfall.start(SPACE).after(AHEAD, np.array([0.4, 0.0, 0.1]), NO_POSE)
    for heading in (2.0, 2.3):
        shortfall = shortfall.after(AHEAD, AHEAD, np.array([np.nan, np.nan, heading]))
    np.testing.assert_allclose(shortfall.behind[2] * SECONDS, -(0.1 * SECONDS + 0.3), atol=1e-12)


def test_a_part_of_a_step_is_a_part_of_its_way() -> None:
    whole = Shortfall.start(SPACE).after(np.array([0.0, 0.2, 0.1]), np.array([0.1, 0.1, 0.2]), NO_POSE)
    parts = Shortfall.start(SPACE)
    for part in (0.3, 0.7):
        parts = parts.after(np.array([0.0, 0.2, 0.1]), np.array([0.1, 0.1, 0.2]), NO_POSE, part)
    np.testing.assert_allclose(parts.behind, whole.behind, atol=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e300])
def test_what_is_no_measurement_counts_as_reached(bad: float) -> None:
    shortfall = Shortfall.start(SPACE)
    for _ in range(2):
        shortfall = shortfall.after(np.array([0.0, bad, 0.1]), np.array([bad, bad, 0.3]), np.full(3, bad))
    np.testing.assert_allclose(shortfall.behind, [0.0, 0.0, -0.4], atol=1e-12)
