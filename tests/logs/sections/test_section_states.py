"""Parabolas fitted about a time, beside NumPy's polynomial fit, a closed form, and the errors that they really have."""

import numpy as np
import pytest

from stepgap.logs.sections.section_states import fit_parabola, noise_std_of, resolution_of
from stepgap.logs.sections.signals import Signal
from stepgap.step import Array

TIME = np.arange(-0.2, 0.2, 0.004)


def flight(time: Array, top: float, height: float) -> Array:
    """Heights of a ballistic flight about its apex."""
    return height - 9.81 / 2 * (time - top) ** 2


def test_it_is_the_fit_of_numpy_with_its_covariance() -> None:
    values = flight(TIME, 0.01, 0.6) + np.random.default_rng(0).normal(0, 1e-3, len(TIME))
    fit = fit_parabola(Signal(TIME, values), 0.0, -0.1, 0.1)
    rows = np.abs(TIME) <= 0.1
    expected, covariance = np.polyfit(TIME[rows], values[rows], 2, cov="unscaled")
    assert fit is not None
    np.testing.assert_allclose([fit.acceleration / 2, fit.rate(0), fit.value(0)], expected)
    np.testing.assert_allclose([fit.rate_std(0, 1), fit.value_std(0, 1)], np.sqrt(np.diag(covariance))[1:])
    assert fit.top == pytest.approx(-expected[1] / (2 * expected[0]))


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_standard_errors_are_those_of_repeated_measurements(correlation: float) -> None:
    rng, fits, errors = np.random.default_rng(1), [], []
    for _ in range(400):
        noise = rng.normal(0, 1e-3, len(TIME))
        for row in range(1, len(noise)):
            noise[row] += correlation * noise[row - 1]
        fit = fit_parabola(Signal(TIME, flight(TIME, 0.0, 0.6) + noise), 0.0, -0.19, 0.19)
        assert fit is not None
        fits.append(fit)
        errors.append((fit.value(0) - 0.6, fit.rate(0), fit.top))
    noise_std = noise_std_of(fits, 0.0)[0]
    stds = (fits[0].value_std(0, noise_std), fits[0].rate_std(0, noise_std), fits[0].top_std(noise_std))
    np.testing.assert_allclose(np.std(errors, axis=0), stds, rtol=0.25)


def test_rounding_errors_are_not_overlooked() -> None:
    """A slow signal rounded to 5 mm has only few different values, so its errors do not average out."""
    step, rng, fits, errors = 0.005, np.random.default_rng(2), [], []
    for height in rng.uniform(0.5, 0.6, 300):
        signal = Signal(TIME, step * np.round(flight(TIME, 0.0, height) / step))
        assert resolution_of(signal) == pytest.approx(step)
        fit = fit_parabola(signal, 0.0, -0.06, 0.06)
        assert fit is not None
        fits.append(fit)
        errors.append(fit.value(0) - height)
    std = np.median([fit.value_std(0, noise) for fit, noise in zip(fits, noise_std_of(fits, step), strict=True)])
    assert 0.5 < std / np.std(errors) < 3
