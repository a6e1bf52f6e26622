"""Samples of a residual's gradient against posteriors that are known in another way."""

import numpy as np
import pytest

from stepgap.learning.gradient_samples import gradient_covariance, gradient_samples
from stepgap.learning.observations import Observations
from stepgap.learning.residual import Residual, no_residual
from stepgap.learning.residual_fit import fit_residual
from stepgap.step import Array, Quantity, StepSpace

SPACE = StepSpace(
    (Quantity("speed", "m/s", 0.0, 0.4), Quantity("height", "m", 0.535, 0.625)), (Quantity("fx", "N", -15.0, 15.0),)
)
SCALE = np.array([0.2, 0.045, 15.0])
POINT = np.array([0.25, 0.57, 3.0])


def fitted(kind: str) -> tuple[Residual, Array]:
    """A residual, and the points that it was fitted to (N, 3)."""
    rng = np.random.default_rng(0)
    points = np.array([0.2, 0.58, 0.0]) + SCALE * rng.uniform(-1, 1, (60, 3))
    error = np.stack([0.05 * np.sin(8 * points[:, 0]), 0.001 * points[:, 2]], axis=1)
    noisy = error + [0.004, 0.001] * rng.normal(size=error.shape)
    return fit_residual(kind, Observations(SPACE, points[:, :2], points[:, 2:], noisy)), points


def test_the_covariance_of_a_straight_line_is_that_of_its_coefficients() -> None:
    residual, points = fitted("linear")
    basis = np.hstack([np.ones((len(points), 1)), (points - [0.2, 0.58, 0.0]) / SCALE])
    inverse = np.linalg.inv(basis.T @ basis)[1:, 1:] / np.outer(SCALE, SCALE)
    expected = residual.noise_std[:, None, None] ** 2 * inverse
    np.testing.assert_allclose(gradient_covariance(residual, POINT, SCALE), expected, rtol=1e-3)


@pytest.mark.parametrize("kind", ["gp", "gp_on_linear", "quadratic"])
def test_the_covariance_explains_the_std_of_a_difference(kind: str) -> None:
    """Var(f(a) − f(b)) follows from two conditional variances; for close points it is that of the slope."""
    residual, _ = fitted(kind)
    covariance = gradient_covariance(residual, POINT, SCALE)
    direction = 0.04 * SCALE * [1, -1, 1]
    ahead, behind = POINT + direction / 2, POINT - direction / 2
    std = residual.std(behind, include_noise=True)
    shifted = residual.append(behind, residual.mean(behind) + std)
    with_ahead = (shifted.mean(ahead) - residual.mean(ahead)) * std
    variance = residual.std(ahead) ** 2 + residual.std(behind) ** 2 - 2 * with_ahead
    np.testing.assert_allclose(np.einsum("i,nij,j->n", direction, covariance, direction), variance, rtol=0.05)


def test_samples_have_the_covariance() -> None:
    residual, _ = fitted("gp")
    samples = gradient_samples(residual, POINT, SCALE, 20_000, np.random.default_rng(1))
    expected, spread = residual.mean_gradient(POINT), samples.std(axis=0)
    assert (np.abs(samples.mean(axis=0) - expected) < 0.05 * spread).all()
    for row, covariance in enumerate(gradient_covariance(residual, POINT, SCALE)):
        scaled = np.cov(samples[:, row].T) * np.outer(SCALE, SCALE)
        wanted = covariance * np.outer(SCALE, SCALE)
        np.testing.assert_allclose(scaled, wanted, atol=0.05 * wanted.max())


def test_no_residual_has_one_gradient() -> None:
    samples = gradient_samples(no_residual(2, 1), POINT, SCALE, 3, np.random.default_rng(0))
    np.testing.assert_array_equal(samples, np.zeros((3, 2, 3)))
