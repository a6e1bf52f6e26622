"""The scaled points of a step space: −1 and 1 are the bounds."""

import numpy as np
import pytest

from stepgap.step import Quantity, StepSpace

SPACE = StepSpace(
    state=(Quantity("speed", "m/s", 0.0, 0.4),),
    command=(Quantity("fx", "N", -15.0, 15.0), Quantity("push", "N", 0.1, 0.7)),
)


def test_points_and_commands_are_inverse_to_each_other() -> None:
    commands = np.random.default_rng(0).uniform(SPACE.command_lower, SPACE.command_upper, (50, 2))
    points = SPACE.point_of(commands)
    assert (np.abs(points) <= 1).all()
    np.testing.assert_allclose(SPACE.command_at(points), commands, rtol=1e-12, atol=1e-12)


def test_commands_of_all_points_are_within_the_bounds() -> None:
    np.testing.assert_array_equal(SPACE.command_at(np.array([-3.0, 3.0])), [-15.0, 0.7])
    grid = SPACE.command_grid(7)
    assert grid.shape == (7, 7, 2)
    assert ((grid >= SPACE.command_lower) & (grid <= SPACE.command_upper)).all()
    np.testing.assert_allclose(grid[0, -1], [-15.0, 0.7], rtol=1e-15)
    np.testing.assert_allclose(grid[3, 3], SPACE.command_centre, rtol=1e-15)
    np.testing.assert_allclose(np.diff(grid[0, :, 1]), 0.1, rtol=1e-12)


def test_its_arrays_are_shared_and_read_only() -> None:
    assert SPACE.command_lower is SPACE.command_lower
    with pytest.raises(ValueError, match="read-only"):
        SPACE.state_scale[0] = 1.0
