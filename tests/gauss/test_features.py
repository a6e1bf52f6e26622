"""Features against difference quotients, and their waves against the kernel whose process they stand for."""

import numpy as np
import pytest
from sklearn.gaussian_process.kernels import Matern

from stepgap.gauss.features import Features
from stepgap.gauss.kernel import MATERN_52
from stepgap.gauss.monomials import monomials

CASES = [(1, 1, 0), (1, 2, 3), (4, 1, 5), (4, 2, 30), (7, 2, 0)]
"""Inputs, degree and number of waves."""


def drawn(inputs: int, degree: int, waves: int, length: float = 2.0) -> Features:
    return Features.drawn(inputs, degree, waves, length, np.random.default_rng(0))


@pytest.mark.parametrize(("inputs", "degree", "waves"), CASES)
def test_they_are_monomials_and_then_waves(inputs: int, degree: int, waves: int) -> None:
    features, points = drawn(inputs, degree, waves), np.random.default_rng(1).uniform(-1, 1, (3, 4, inputs))
    found = features(points)
    assert found.shape == (3, 4, features.count)
    assert (features.waves, features.monomials + features.waves) == (waves, features.count)
    np.testing.assert_array_equal(found[..., : features.monomials], monomials(points, degree))
    for number in range(waves):
        angle = points @ features.frequencies[number] + features.shifts[number]
        expected = np.sqrt(2 / waves) * np.cos(angle)
        np.testing.assert_allclose(found[..., features.monomials + number], expected, atol=1e-12)


@pytest.mark.parametrize(("inputs", "degree", "waves"), CASES)
def test_the_gradient_is_the_derivative(inputs: int, degree: int, waves: int) -> None:
    features, points = drawn(inputs, degree, waves), np.random.default_rng(2).uniform(-1, 1, (3, 4, inputs))
    gradient = features.gradient(points)
    assert gradient.shape == (3, 4, features.count, inputs)
    for column, step in enumerate(1e-5 * np.eye(inputs)):
        difference = (features(points + step) - features(points - step)) / 2e-5
        np.testing.assert_allclose(gradient[..., column], difference, atol=1e-8)


@pytest.mark.parametrize(("inputs", "length"), [(1, 2.0), (4, 2.0), (4, 0.7)])
def test_many_waves_are_a_gaussian_process_with_a_matern_kernel(inputs: int, length: float) -> None:
    """The covariance of two points is the sum of the products of their waves; that of r waves scatters by √(1 / r)."""
    waves = 40_000
    features, points = drawn(inputs, 1, waves, length), np.random.default_rng(3).uniform(-1, 1, (20, inputs))
    found = features(points)[:, features.monomials :]
    covariance = found @ found.T
    squared = np.sum(((points[:, None] - points[None]) / length) ** 2, axis=-1)
    np.testing.assert_allclose(covariance, MATERN_52.covariance(squared), atol=5 / np.sqrt(waves))
    np.testing.assert_allclose(covariance, Matern(length, nu=2.5)(points), atol=5 / np.sqrt(waves))
