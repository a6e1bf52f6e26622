"""Offsets that follow what drifts and what comes round with the place, and stay at zero where nothing does."""

from math import nan

import numpy as np

from stepgap.learning.drift import RATES, Drift

NOWHERE = np.full(1000, nan)


def offsets_over(left: np.ndarray, places: np.ndarray = NOWHERE) -> np.ndarray:
    """The offset before each of the steps that leave these errors (steps, n) at these places."""
    drift, offsets = Drift.none(left.shape[1]), []
    for error, place in zip(left, places, strict=False):
        offsets.append(drift.offset(place))
        drift = drift.followed(error, place)
    return np.array(offsets)


def test_nothing_is_added_before_the_first_step() -> None:
    for place in (nan, 0.0, 1e6):
        np.testing.assert_array_equal(Drift.none(3).offset(place), np.zeros(3))


def test_each_filter_is_the_regression_that_trusts_its_past_so_far() -> None:
    """Oracle: after each step c is the least-squares compromise between the new error and what was known."""
    rng = np.random.default_rng(3)
    left, places, drift = rng.normal(0, 1, (40, 2)), rng.uniform(0, 100, 40), Drift.none(2)
    places[[0, 7, 8]] = nan
    for error, place in zip(left, places, strict=True):
        drift = drift.followed(error, place)
    for rate, (blind, seeing) in zip(RATES, zip(*np.split(drift.coefficients, 2), strict=True), strict=True):
        for size, found in ((1, blind), (3, seeing)):
            known, covariance = np.zeros((size, 2)), np.eye(size)
            for error, place in zip(left, places, strict=True):
                terms = np.nan_to_num([1.0, np.sin(place), np.cos(place)])[:size]
                precision = np.linalg.inv((1 - rate**2) * covariance + rate**2 * np.eye(size))
                root = np.linalg.cholesky(precision).T
                rows, values = np.vstack([root, terms]), np.vstack([root @ known, error])
                known = np.linalg.lstsq(rows, values, rcond=None)[0]
                covariance = np.linalg.inv(rows.T @ rows)
            np.testing.assert_allclose(found[:size], known, atol=1e-10)
            assert (found[size:] == 0).all()


def test_a_filter_without_forgetting_is_the_regression_of_all_steps() -> None:
    rng = np.random.default_rng(6)
    left, places, drift = rng.normal(0, 1, (40, 1)), rng.uniform(0, 100, 40), Drift.none(1)
    for error, place in zip(left, places, strict=True):
        drift = drift.followed(error, place)
    terms = np.column_stack([np.ones(40), np.sin(places), np.cos(places)])
    slowest = drift.coefficients[len(RATES)]
    np.testing.assert_allclose(slowest, np.linalg.solve(terms.T @ terms + np.eye(3), terms.T @ left), atol=0.02)


def test_what_is_not_seen_for_long_is_as_unsure_as_at_first_and_no_more() -> None:
    """A robot that hops in place while something else drifts: a quarter round on nothing is known, not less."""
    drift = Drift.none(1)
    for step in range(3000):
        drift = drift.followed(np.array([3 * np.sin(step / 20)]), 0.0)
    assert (np.linalg.eigvalsh(drift.covariance) < 1 + 1e-9).all()
    assert drift.std(np.pi / 2) < np.sqrt(2)


def test_the_standard_deviation_of_an_offset_is_what_it_misses() -> None:
    """Of a leaning boom, in standard deviations of the noise; nothing where nothing is followed."""
    rng = np.random.default_rng(5)
    places, missed, stds = np.cumsum(rng.uniform(0.05, 0.35, 227)), [], []
    for _ in range(100):
        drift, phase = Drift.none(1), rng.uniform(0, 2 * np.pi)
        assert drift.std(0.0) == 0
        for place in places:
            added = 1.5 * np.sin(place + phase)
            missed.append(added - drift.offset(place)[0])
            stds.append(drift.std(place)[0])
            drift = drift.followed(np.array([added + rng.normal()]), place)
    late = np.arange(len(missed)) % 227 > 100
    assert 0.7 < np.std(np.array(missed)[late]) / np.mean(np.array(stds)[late]) < 1.3


def test_noise_alone_is_not_followed() -> None:
    """On average over many records: what is added makes errors larger by next to nothing."""
    rng = np.random.default_rng(0)
    left, round_and_round = rng.normal(0, 1, (227, 200)), np.arange(227) * 0.12
    for places in (NOWHERE, round_and_round):
        missed = left - offsets_over(left, places)
        assert np.mean(missed**2) < 1.02 * np.mean(left**2)


def test_a_slow_wave_is_followed_coordinate_by_coordinate() -> None:
    rng, steps = np.random.default_rng(1), np.arange(227)
    wave = 2 * np.sin(2 * np.pi * steps / 55)[:, None]
    left = np.hstack([wave, 0 * wave]) + rng.normal(0, 1, (227, 2))
    missed = (left - offsets_over(left))[40:]
    assert np.std(missed[:, 0]) < 1.25 < 1.6 < np.std(left[40:, 0])
    assert np.std(missed[:, 1]) < 1.05 * np.std(left[40:, 1])


def test_what_comes_round_with_the_place_is_known_after_one_round() -> None:
    """A leaning boom: next to nothing of it is left, whatever the speed, where the place is known."""
    rng = np.random.default_rng(4)
    places = np.cumsum(rng.uniform(0.05, 0.35, 227))
    noise = rng.normal(0, 1, (227, 50))
    left = 0.5 + 1.2 * np.sin(places - 0.7)[:, None] + noise
    after = places > 2 * np.pi
    assert np.std((left - offsets_over(left, places))[after]) < 1.05
    assert np.std((left - offsets_over(left))[after]) > 1.12


def test_after_the_drift_it_goes_back_to_nothing() -> None:
    rng = np.random.default_rng(2)
    left = np.where(np.arange(400) < 100, 3.0, 0.0)[:, None] + rng.normal(0, 1, (400, 20))
    offsets = offsets_over(left)
    assert np.median(offsets[80:100]) > 2.5
    assert np.mean((left - offsets)[200:] ** 2) < 1.1 * np.mean(left[200:] ** 2)
