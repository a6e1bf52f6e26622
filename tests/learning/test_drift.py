"""Offsets that follow what drifts, and stay at zero where nothing does."""

import numpy as np

from stepgap.learning.drift import GAINS, Drift


def offsets_over(left: np.ndarray) -> np.ndarray:
    """The offset before each of the steps that leave these errors (steps, n)."""
    drift, offsets = Drift.none(left.shape[1]), []
    for error in left:
        offsets.append(drift.offset)
        drift = drift.followed(error)
    return np.array(offsets)


def test_nothing_is_added_before_the_first_step() -> None:
    np.testing.assert_array_equal(Drift.none(3).offset, np.zeros(3))


def test_each_gain_is_an_exponential_mean() -> None:
    drift = Drift.none(1).followed(np.array([1.0])).followed(np.array([0.0]))
    np.testing.assert_allclose(drift.offsets[:, 0], GAINS * (1 - GAINS))


def test_noise_alone_is_not_followed() -> None:
    """On average over many records: what is added makes errors larger by next to nothing."""
    rng = np.random.default_rng(0)
    left = rng.normal(0, 1, (227, 200))
    missed = left - offsets_over(left)
    assert np.mean(missed**2) < 1.02 * np.mean(left**2)


def test_a_slow_wave_is_followed_coordinate_by_coordinate() -> None:
    rng, steps = np.random.default_rng(1), np.arange(227)
    wave = 2 * np.sin(2 * np.pi * steps / 55)[:, None]
    left = np.hstack([wave, 0 * wave]) + rng.normal(0, 1, (227, 2))
    missed = (left - offsets_over(left))[40:]
    assert np.std(missed[:, 0]) < 1.25 < 1.6 < np.std(left[40:, 0])
    assert np.std(missed[:, 1]) < 1.05 * np.std(left[40:, 1])


def test_after_the_drift_it_goes_back_to_nothing() -> None:
    rng = np.random.default_rng(2)
    left = np.where(np.arange(400) < 100, 3.0, 0.0)[:, None] + rng.normal(0, 1, (400, 20))
    offsets = offsets_over(left)
    assert np.median(offsets[80:100]) > 2.5
    assert np.mean((left - offsets)[200:] ** 2) < 1.1 * np.mean(left[200:] ** 2)
