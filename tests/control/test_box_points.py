"""Points all over a box: a grid of one or two axes, few and well spread for many."""

from itertools import combinations, product

import numpy as np
import pytest
from scipy.stats import qmc

from stepgap.control.box_points import box_grid, box_points, composite_design


@pytest.mark.parametrize(("count", "k", "side"), [(81, 2, 9), (25, 2, 5), (1089, 2, 33), (81, 1, 81), (5, 2, 3)])
def test_one_and_two_axes_have_an_even_grid(count: int, k: int, side: int) -> None:
    np.testing.assert_array_equal(box_points(count, k), box_grid(side, k).reshape(-1, k))


@pytest.mark.parametrize("k", [3, 4, 7, 12, 30])
@pytest.mark.parametrize("count", [25, 81, 1089])
def test_the_number_of_points_does_not_grow_with_the_axes(count: int, k: int) -> None:
    points = box_points(count, k)
    assert points.shape == (count, k)
    assert np.abs(points).max() <= 1
    assert len(np.unique(points, axis=0)) == count


@pytest.mark.parametrize("k", [1, 2, 3])
def test_the_design_has_all_corners_and_ends_of_up_to_three_axes(k: int) -> None:
    design = {tuple(point) for point in composite_design(k).tolist()}
    ends = {tuple(sign * row) for row in np.eye(k) for sign in (-1, 1)}
    assert design == {(0.0,) * k} | ends | set(product((-1.0, 1.0), repeat=k))


@pytest.mark.parametrize("k", [2, 3, 5, 8, 12])
def test_any_two_axes_of_a_design_meet_in_all_corners_equally_often(k: int) -> None:
    design = composite_design(k)
    corners = design[np.abs(design).min(axis=1) == 1]
    assert len(corners) < 4 * k + 1
    for pair in combinations(range(k), 2):
        _, counts = np.unique(corners[:, pair], axis=0, return_counts=True)
        assert counts.tolist() == [len(corners) // 4] * 4


@pytest.mark.parametrize("k", [3, 6, 10])
def test_scattered_points_are_spread_better_than_random_ones(k: int) -> None:
    scattered = (box_points(1000, k)[len(composite_design(k)) :] + 1) / 2
    random = np.random.default_rng(0).random(scattered.shape)
    assert qmc.discrepancy(scattered) < qmc.discrepancy(random) / 1.5
