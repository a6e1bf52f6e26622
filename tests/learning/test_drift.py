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


def test_each_filter_is_the_gaussian_process_of_its_random_walk() -> None:
    """Oracle: the same posterior mean from the covariance of all steps at once."""
    rng = np.random.default_rng(3)
    left, places, drift = rng.normal(0, 1, (40, 2)), rng.uniform(0, 100, 40), Drift.none(2)
    places[:7] = nan
    for error, place in zip(left, places, strict=True):
        drift = drift.followed(error, place)
    terms = np.column_stack([np.ones(40), np.nan_to_num(np.sin(places)), np.nan_to_num(np.cos(places))])
    number = np.arange(1.0, 41.0)
    for rate, coefficients in zip(RATES, drift.coefficients, strict=True):
        walked = 1 + rate**2 * np.minimum(number[:, None], number)
        weights = np.linalg.solve(terms @ terms.T * walked + np.eye(40), left)
        np.testing.assert_allclose(coefficients, (terms * walked[-1][:, None]).T @ weights, atol=1e-12)


def test_the_doubt_of_an_offset_is_what_it_misses() -> None:
    """Of a leaning boom, in standard deviations of the noise; nothing where nothing is followed."""
    rng = np.random.default_rng(5)
    places, missed, doubts = np.cumsum(rng.uniform(0.05, 0.35, 227)), [], []
    for _ in range(100):
        drift, phase = Drift.none(1), rng.uniform(0, 2 * np.pi)
        assert drift.doubt(0.0) == 0
        for place in places:
            added = 1.5 * np.sin(place + phase)
            missed.append(added - drift.offset(place)[0])
            doubts.append(drift.doubt(place)[0])
            drift = drift.followed(np.array([added + rng.normal()]), place)
    late = np.arange(len(missed)) % 227 > 100
    assert 0.7 < np.std(np.array(missed)[late]) / np.mean(np.array(doubts)[late]) < 1.3


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
