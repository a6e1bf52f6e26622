"""Searches of a least norm that is far from zero, where the linearised function lacks most of the curvature."""

import numpy as np
import pytest

from stepgap.control.gauss_newton import minimise
from stepgap.step import Array


@pytest.mark.parametrize("start", [-0.3, 0.1, 0.4])
@pytest.mark.parametrize("curvature", [-1.5, -2.0, -4.0, -8.0])
def test_a_minimum_is_found_from_which_gauss_newton_diverges(curvature: float, start: float) -> None:
    """The norm of (x + 1, λx² + x − 1) is least at 0 for λ < 1.

    Near there an undamped step leads from x to λx, because Jᵀr ≈ 2 (1 − λ) x and JᵀJ ≈ 2.
    """
    evaluations = 0

    def function(point: Array) -> Array:
        nonlocal evaluations
        evaluations += 1
        x = point[..., 0]
        return np.stack([x + 1, curvature * x**2 + x - 1], axis=-1)

    def jacobian(point: Array) -> Array:
        return np.array([[1.0], [2 * curvature * point[0] + 1]])

    found = minimise(function, jacobian, np.array([start]))
    assert found.converged
    assert found.point == pytest.approx([0], abs=2e-5)
    assert found.distance == pytest.approx(np.sqrt(2), abs=1e-9)
    assert evaluations <= 24
