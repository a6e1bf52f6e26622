"""Sentences of `stepgap fit`: what the remaining errors of successive steps say."""

import numpy as np

from stepgap.logs.fits.fit_results import lacking
from stepgap.logs.fits.validation import HeldOut
from stepgap.step import Quantity

STATE = (Quantity("speed", "m/s", 0.0, 1.0), Quantity("height", "m", 0.0, 1.0))
COUNT = 400


def sentence(speed: np.ndarray, height: np.ndarray, follows: np.ndarray) -> str:
    error = np.stack([speed, height], axis=1)
    return lacking(STATE, HeldOut("gp", error, np.zeros_like(error), np.ones_like(error), 0.0), follows)


def test_errors_that_last_and_errors_of_measured_states() -> None:
    rng, follows = np.random.default_rng(0), np.arange(COUNT) > 0
    noise = rng.normal(size=(3, COUNT + 1))
    independent, measured = noise[0, 1:], np.diff(noise[1])  # of a state that a step does not change: n[k+1] − n[k]
    slow = np.convolve(noise[2], [0.5, 0.5], "valid")  # the mean of two successive disturbances: correlation 0.5
    assert sentence(independent, independent, follows).endswith("not correlated (within ± 0.10)")
    lasting = sentence(slow, independent, follows)
    assert "are correlated (speed 0.5" in lasting
    assert lasting.endswith("± 0.10): the state lacks something that lasts")
    assert "alternate (height -0.5" in sentence(independent, measured, follows)
    both = sentence(slow, measured, follows)
    assert "something that lasts, and alternate (height -0.5" in both
    assert "too few successive steps" in sentence(slow, measured, np.arange(COUNT) < 2)
