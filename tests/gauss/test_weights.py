"""Weights against batch regression in information form, scikit-learn's answer, and what a random walk adds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import DotProduct

from stepgap.gauss.weights import Weights
from stepgap.step import Array

VALUES, SIZE = 2, 6


def covariances(rng: np.random.Generator, size: int = SIZE) -> Array:
    """Positive definite matrices; shape (2, k, k)."""
    roots = rng.normal(size=(VALUES, size, size))
    return roots @ np.swapaxes(roots, 1, 2) + 0.1 * np.eye(size)


def prior(rng: np.random.Generator, size: int = SIZE) -> Weights:
    return Weights.of_moments(rng.normal(size=(VALUES, size)), covariances(rng, size))


def batch(before: Weights, features: Array, values: Array, noise: Array) -> tuple[Array, Array]:
    """Mean and covariance after all values at once: information adds up (features (N, k), values and noise (N, n))."""
    means, found = np.empty_like(before.mean), np.empty_like(before.root)
    for n, (mean, covariance) in enumerate(zip(before.mean, before.covariance, strict=True)):
        information = np.linalg.inv(covariance)
        total = information + (features.T / noise[:, n]) @ features
        means[n] = np.linalg.solve(total, information @ mean + features.T @ (values[:, n] / noise[:, n]))
        found[n] = np.linalg.inv(total)
    return means, found


def learned(weights: Weights, features: Array, values: Array, noise: Array) -> Weights:
    for row in zip(features, values, noise, strict=True):
        weights = weights.learned(*row)
    return weights


def check_triangular(weights: Weights) -> None:
    assert np.isfinite(weights.mean).all()
    assert np.isfinite(weights.root).all()
    assert (weights.root == np.tril(weights.root)).all()
    assert (np.diagonal(weights.root, axis1=1, axis2=2) > 0).all()


@pytest.mark.parametrize("seed", range(5))
def test_values_one_by_one_are_a_batch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    before, features = prior(rng), rng.normal(size=(25, SIZE))
    values, noise = rng.normal(size=(25, VALUES)), rng.uniform(0.01, 2.0, (25, VALUES))
    mean, covariance = batch(before, features, values, noise)
    found = learned(before, features, values, noise)
    np.testing.assert_allclose(found.mean, mean, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-8, atol=1e-10)
    order = rng.permutation(25)
    other = learned(before, features[order], values[order], noise[order])
    np.testing.assert_allclose(other.mean, found.mean, rtol=1e-9, atol=1e-10, err_msg="the order does not matter")


def test_it_is_the_gaussian_process_with_a_linear_kernel() -> None:
    """The function-space view of scikit-learn; weights of a prior standard deviation of 1, noise of 0.1."""
    rng = np.random.default_rng(3)
    points, values, queries = rng.normal(size=(15, SIZE)), rng.normal(size=15), rng.normal(size=(8, SIZE))
    kernel = DotProduct(0.0, "fixed")
    process = GaussianProcessRegressor(kernel, alpha=0.01, optimizer=None)  # pyright: ignore[reportArgumentType]
    process.fit(points, values)
    mean, std = process.predict(queries, return_std=True)
    weights = Weights(np.zeros((1, SIZE)), np.eye(SIZE)[None])
    found = learned(weights, points, values[:, None], np.full((15, 1), 0.01)).predicted(queries)
    np.testing.assert_allclose(found.mean[:, 0], mean, rtol=1e-7)
    np.testing.assert_allclose(np.sqrt(found.variance[:, 0]), std, rtol=1e-6)


def test_predictions_have_the_moments_of_the_weighted_sum() -> None:
    rng = np.random.default_rng(1)
    weights, features = prior(rng), rng.normal(size=(3, 4, SIZE))
    found = weights.predicted(features)
    np.testing.assert_allclose(found.mean, np.einsum("...k,nk->...n", features, weights.mean))
    expected = np.einsum("...a,nab,...b->...n", features, weights.covariance, features)
    np.testing.assert_allclose(found.variance, expected, rtol=1e-10)
    assert found.mean.shape == found.variance.shape == (3, 4, VALUES)


def test_each_value_is_learned_as_if_it_were_alone() -> None:
    rng = np.random.default_rng(2)
    weights, features, values, noise = prior(rng), rng.normal(size=SIZE), rng.normal(size=2), np.array([0.1, 3.0])
    both = weights.learned(features, values, noise)
    for n in range(VALUES):
        alone = Weights(weights.mean[n : n + 1], weights.root[n : n + 1])
        found = alone.learned(features, values[n : n + 1], noise[n : n + 1])
        np.testing.assert_array_equal(found.mean[0], both.mean[n])
        np.testing.assert_array_equal(found.root[0], both.root[n])


@pytest.mark.parametrize("places", [[0], [5], [1, 4], [0, 2, 5], [3, 3]])
def test_a_random_walk_adds_its_variance_on_the_diagonal(places: list[int]) -> None:
    rng = np.random.default_rng(4)
    weights, variance = prior(rng), np.array([0.3, 7.0])
    added = np.zeros(SIZE)
    for place in places:
        added[place] += 1.0
    found = weights.walked(places, variance)
    np.testing.assert_allclose(found.covariance, weights.covariance + variance[:, None, None] * np.diag(added))
    np.testing.assert_array_equal(found.mean, weights.mean)
    check_triangular(found)


def test_widened_weights_have_the_sum_of_the_covariances() -> None:
    rng = np.random.default_rng(6)
    weights, covariance = prior(rng), covariances(rng)
    found = weights.widened(covariance)
    np.testing.assert_allclose(found.covariance, weights.covariance + covariance, rtol=1e-12)
    np.testing.assert_array_equal(found.mean, weights.mean)
    check_triangular(found)


def test_restarted_weights_are_independent_of_the_others_which_stay() -> None:
    rng = np.random.default_rng(7)
    weights, places, variance = prior(rng), [1, 4], np.array([[0.5, 2.0], [1.0, 3.0]])
    found, others = weights.restarted(places, variance), [0, 2, 3, 5]
    np.testing.assert_array_equal(found.mean[:, places], 0.0)
    np.testing.assert_array_equal(found.mean[:, others], weights.mean[:, others])
    for n in range(VALUES):
        covariance = found.covariance[n]
        np.testing.assert_allclose(covariance[np.ix_(places, places)], np.diag(variance[n]), atol=1e-14)
        np.testing.assert_allclose(covariance[np.ix_(places, others)], 0.0, atol=1e-14)
        np.testing.assert_allclose(covariance[np.ix_(others, others)], weights.covariance[n][np.ix_(others, others)])


@given(st.integers(1, 12), st.floats(-6, 6), st.floats(-8, 4), st.integers(0, 2**32 - 1))
def test_the_root_stays_triangular_with_a_positive_diagonal(size: int, spread: float, noise: float, seed: int) -> None:
    """However large and small the features are beside each other and the noise; a variance never grows by learning."""
    rng = np.random.default_rng(seed)
    weights = Weights(np.zeros((VALUES, size)), np.tile(np.eye(size), (VALUES, 1, 1)))
    factors = 10 ** rng.uniform(min(spread, 0), max(spread, 0), (30, size))
    for row, features in enumerate(factors * rng.choice([-1.0, 0.0, 1.0], (30, size))):
        before = np.sum(weights.root**2, axis=-1)
        weights = weights.learned(features, rng.normal(size=VALUES), np.full(VALUES, 10.0**noise))
        check_triangular(weights)
        assert (np.sum(weights.root**2, axis=-1) <= (1 + 1e-9) * before).all()
        if row % 7 == 0:
            weights = weights.walked([int(rng.integers(size))], np.full(VALUES, 10.0 ** rng.uniform(-9, 0)))
            check_triangular(weights)


def test_after_a_hundred_thousand_values_it_is_still_the_batch() -> None:
    """The information grows to 10⁹ times that of the prior in some directions, and not at all in others."""
    rng, size, count = np.random.default_rng(9), 8, 100_000
    before = prior(rng, size)
    features = rng.normal(size=(count, size)) * np.logspace(-4, 1, size)
    features[:, 3] = features[:, 2]  # what these two have in common is learned, their difference never
    values = features @ rng.normal(size=(size, VALUES)) + 0.1 * rng.normal(size=(count, VALUES))
    noise = np.full((count, VALUES), 0.01)
    found = learned(before, features, values, noise)
    check_triangular(found)
    mean, covariance = batch(before, features, values, noise)
    assert (np.linalg.eigvalsh(found.covariance) > 0).all()
    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert (np.abs(found.mean - mean) < 1e-6 * std).all()
    correlation = std[:, :, None] * std[:, None, :]
    np.testing.assert_allclose(found.covariance / correlation, covariance / correlation, atol=1e-6)
