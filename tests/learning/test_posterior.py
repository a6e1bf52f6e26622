"""The residual `posterior` against difference quotients, the weights it is made of, and fits to the other values."""

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from stepgap.gauss.features import Features
from stepgap.gauss.weights import Weights
from stepgap.learning.first_beliefs import unknown_belief
from stepgap.learning.polynomial import LINEAR
from stepgap.learning.posterior import (
    NOISE_ROUNDS,
    POSTERIOR,
    Posterior,
    features_from_dict,
    features_to_dict,
    posterior_from_dict,
)
from stepgap.learning.regression import Regression, TrainingData
from stepgap.step import Array
from tests.learning.residual_contract import CENTRE, INPUTS, QUERIES, SCALE, VALUE_SCALE, training_data

FEATURES = Features.drawn(INPUTS, 2, 5, 2.0, np.random.default_rng(0))
COUNT = FEATURES.count
NOISE = 0.05


def prior(size: int = COUNT) -> Weights:
    rng = np.random.default_rng(1)
    root = 0.1 * rng.normal(size=(size, size))
    return Weights.of_moments(0.1 * rng.normal(size=(1, size)), (root @ root.T + 0.01 * np.eye(size))[None])


def posterior(data: TrainingData, base: Regression | None = None, side: Sequence[float] = ()) -> Posterior:
    """Learned from the data one by one, with a known noise, as what a base leaves; with numbers that follow."""
    weights, values = prior(COUNT + len(side)), data.values - (base.mean(data.points) if base else 0.0)
    for point, value in zip(data.scaled(data.points), values / data.value_scale, strict=True):
        row = np.append(FEATURES(point), np.zeros(len(side)))
        weights = weights.learned(row, np.array([value]), np.array([NOISE**2]))
    mean, covariance = weights.mean[0], weights.covariance[0]
    return Posterior(data, FEATURES, mean, covariance, np.array(side), NOISE, tuple(range(INPUTS)), base)


def regressions() -> dict[str, Posterior]:
    data = training_data(12)
    linear = LINEAR.fit(training_data(8, seed=3))
    # the third input, such as a lagged one, is none of the features
    fewer = Features.drawn(INPUTS - 1, 2, 5, 2.0, np.random.default_rng(0))
    weights = prior(fewer.count)
    few = Posterior(data, fewer, weights.mean[0], weights.covariance[0], np.zeros(0), NOISE, (0, 1, 3), linear)
    return {
        "alone": posterior(data),
        "with a base": posterior(data, linear),
        "with a side": posterior(data, side=(0.8, -0.6, 0.3)),
        "with both": posterior(data, linear, (0.8, -0.6, 0.3)),
        "of some inputs": few,
    }


REGRESSIONS = regressions()


@pytest.fixture(params=REGRESSIONS)
def regression(request: pytest.FixtureRequest) -> Posterior:
    return REGRESSIONS[request.param]


def test_its_moments_are_those_of_the_weighted_sum(regression: Posterior) -> None:
    x = ((QUERIES - CENTRE) / SCALE)[:, regression.used]
    side = np.tile(regression.side, (len(x), 1))
    rows = np.hstack([regression.features(x), side])
    own = VALUE_SCALE * rows @ regression.mean_weights
    variance = VALUE_SCALE**2 * np.einsum("pa,ab,pb->p", rows, regression.covariance, rows)
    base = regression.base
    mean, std = (base.mean(QUERIES), base.std(QUERIES)) if base else (0.0, 0.0)
    np.testing.assert_allclose(regression.mean(QUERIES), own + mean, rtol=1e-10)
    np.testing.assert_allclose(regression.std(QUERIES), np.sqrt(variance + std**2), rtol=1e-10)
    assert regression.noise_std == NOISE * VALUE_SCALE


def test_gradients_are_derivatives(regression: Posterior) -> None:
    pairs: list[Any] = [(regression.mean, regression.mean_gradient), (regression.std, regression.std_gradient)]
    for function, gradient in pairs:
        for column, step in enumerate(np.diag(1e-5 * SCALE)):
            difference = (function(QUERIES + step) - function(QUERIES - step)) / 2e-5
            found = gradient(QUERIES)[..., column] * SCALE[column]
            np.testing.assert_allclose(found, difference, rtol=1e-5, atol=1e-8 * VALUE_SCALE)


def test_where_nothing_is_uncertain_the_gradient_of_the_deviation_is_zero() -> None:
    certain = replace(posterior(training_data(3)), covariance=np.zeros((COUNT, COUNT)))
    np.testing.assert_array_equal(certain.std(QUERIES), 0.0)
    np.testing.assert_array_equal(certain.std_gradient(QUERIES), 0.0)


@pytest.mark.parametrize("with_base", [False, True])
def test_appending_is_what_weights_learn(with_base: bool) -> None:
    data, more = training_data(6), training_data(5, seed=4)
    base = LINEAR.fit(training_data(8, seed=3)) if with_base else None
    grown = posterior(data, base)
    for point, value in zip(more.points, more.values, strict=True):
        grown = grown.append(point, float(value))
    points, values = np.vstack([data.points, more.points]), np.append(data.values, more.values)
    expected = posterior(replace(data, points=points, values=values), base)
    np.testing.assert_allclose(grown.mean_weights, expected.mean_weights, atol=1e-10)
    np.testing.assert_allclose(grown.covariance, expected.covariance, atol=1e-12)
    np.testing.assert_array_equal(grown.points, points)
    np.testing.assert_array_equal(grown.values, values)


def unknown(data: TrainingData, base: Regression | None, noise: float) -> Posterior:
    """Of a robot of which nothing was known before, with a known noise [half ranges]."""
    weights, values = unknown_belief(FEATURES).weights, data.values - (base.mean(data.points) if base else 0.0)
    for point, value in zip(data.scaled(data.points), values / data.value_scale, strict=True):
        weights = weights.learned(FEATURES(point), np.array([value]), np.array([noise**2]))
    mean, covariance = weights.mean[0], weights.covariance[0]
    return Posterior(data, FEATURES, mean, covariance, np.zeros(0), noise, tuple(range(INPUTS)), base)


def noise_of(data: TrainingData, base: Regression | None, rounds: int) -> float:
    """Noise of the values about what they say together, and of those that it is expected from [half ranges]."""
    prior, noise = unknown_belief(FEATURES), NOISE
    for _ in range(rounds):
        found = unknown(data, base, noise)
        error = (data.values - found.mean(data.points)) / VALUE_SCALE
        known = sum(FEATURES(point) @ found.covariance @ FEATURES(point) for point in data.scaled(data.points))
        counted = float(prior.freedom[0]) - 2 + len(error) - known / noise**2
        noise = float(np.sqrt((prior.squares[0] + error @ error) / counted))
    return noise


@pytest.mark.parametrize(
    "blocks", [[slice(0, 4), slice(4, 5), slice(5, 12)], [slice(row, row + 1) for row in range(12)]]
)
@pytest.mark.parametrize("with_base", [False, True])
def test_left_out_is_a_fit_to_the_others(blocks: list[slice], with_base: bool) -> None:
    """Whatever several beliefs, which were not told of all values equally, have made of them."""
    data, base = training_data(12), LINEAR.fit(training_data(8, seed=3)) if with_base else None
    noise, last = (noise_of(data, base, rounds) for rounds in (NOISE_ROUNDS - 1, NOISE_ROUNDS))
    assert last == pytest.approx(noise, rel=0.1)
    found = posterior(data, base, (0.8, -0.6, 0.3)).left_out(blocks)
    for block in blocks:
        others = unknown(data.without(block), base, noise)
        np.testing.assert_allclose(found.mean[block], others.mean(data.points[block]), rtol=1e-6, atol=1e-9)
        std = last / noise * VALUE_SCALE * np.hypot(others._own_std(data.points[block])[1], noise)
        np.testing.assert_allclose(found.std[block], std, rtol=1e-6)


def test_its_fit_is_about_a_robot_of_which_nothing_is_known() -> None:
    """It follows the data, is sure where they are, and its intervals hold."""
    regression, others = POSTERIOR.fit(training_data(40)), training_data(300, seed=5)
    mean, std = regression.predict(others.points)
    error = others.values - mean
    assert np.sqrt(np.mean(error**2)) < 1.5 * 0.05 * VALUE_SCALE
    assert 0.9 < np.mean(np.abs(error) < 1.96 * std) <= 1.0
    few = POSTERIOR.fit(training_data(2))
    assert (few.std(others.points) >= regression.std(others.points)).all()


def test_many_values_have_waves_besides() -> None:
    few, many = (POSTERIOR.fit(training_data(count)) for count in (20, 120))
    for regression, waves in ((few, False), (many, True)):
        assert isinstance(regression, Posterior)
        assert (regression.features.waves > 0) == waves


@pytest.mark.parametrize("name", ["alone", "with a side", "of some inputs"])
def test_it_is_restored_bit_for_bit_without_its_base_and_side(name: str) -> None:
    """What follows the features is that of one step, and a base is saved by its own model."""
    regression = replace(REGRESSIONS[name], base=None)
    saved = json.loads(json.dumps(regression.to_dict(), allow_nan=False))
    restored = posterior_from_dict(saved)
    assert restored.to_dict() == saved
    assert restored.side.shape == regression.side.shape
    assert not restored.side.any()
    alone = replace(regression, side=0 * regression.side)
    for method in ("mean", "std", "mean_gradient", "std_gradient"):
        np.testing.assert_array_equal(getattr(restored, method)(QUERIES), getattr(alone, method)(QUERIES))


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        ("weights", [0.1] * (COUNT - 1), "weights"),
        ("weights", "many", "weights"),
        ("covariance", [[1.0]], "covariance"),
        ("covariance", [[0.1] * COUNT] * (COUNT - 1), "covariance"),
        ("noise", 0.0, "noise"),
        ("noise", [0.1], "noise"),
        ("used", [0, 1, 2], "used"),
        ("used", [0, 1, 2, 4], "used"),
        ("used", [0, 1, 2, -1], "used"),
        ("features", None, "features"),
        ("points", [[0.0]], "points"),
    ],
)
def test_damaged_data_are_refused_by_the_name_of_the_key(key: str, value: object, named: str) -> None:
    saved = {**posterior(training_data(5)).to_dict(), key: value}
    with pytest.raises(ValueError, match=f"^{named}"):
        posterior_from_dict(saved)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("inputs", 0),
        ("inputs", 2.5),
        ("inputs", 10**6),
        ("inputs", 900),
        ("degree", 3),
        ("degree", None),
        ("frequencies", [[1.0]]),
        ("frequencies", [[1.0] * INPUTS] * 4),
        ("shifts", [0.0] * 4),
        ("shifts", "none"),
    ],
)
def test_damaged_features_are_refused(key: str, value: object) -> None:
    saved = {**features_to_dict(FEATURES), key: value}
    with pytest.raises(ValueError, match=r"inputs|degree|frequencies|shifts"):
        features_from_dict(saved)


@pytest.mark.parametrize("waves", [0, 5])
def test_features_are_restored(waves: int) -> None:
    features = Features.drawn(INPUTS, 2, waves, 2.0, np.random.default_rng(0))
    restored = features_from_dict(json.loads(json.dumps(features_to_dict(features))))
    points: Array = np.random.default_rng(1).uniform(-1, 1, (6, INPUTS))
    np.testing.assert_array_equal(restored(points), features(points))
