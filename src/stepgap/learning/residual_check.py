"""Checks of what a residual model of any package returns: its mistakes are named before a robot moves with them."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import numpy as np

from stepgap.base.errors import InputError, StepGapError
from stepgap.learning.regression import Regression, ResidualModel
from stepgap.step import Array

CHECKED_POINTS: Final = 30
"""Largest number of points at which a new regression is checked; they are spread over those that it was fitted to."""

LARGEST_RETURNED: Final = 1e100
"""Largest absolute value of a prediction and of its gradient in SI units; squares of it are still finite."""


class ResidualError(InputError):
    """A residual model failed, or returned something that is not valid; the message names it."""


def failed(model: ResidualModel, error: Exception) -> ResidualError:
    """Returns the error that names the model in which another error arose."""
    return ResidualError(f"residual '{model.name}': {type(error).__name__}: {error}")


@contextmanager
def naming_model(model: ResidualModel) -> Iterator[None]:
    """Names the model in errors that arise in it.

    Raises:
        ResidualError: Any error arose but those that StepGap raises deliberately; that error is its cause.
    """
    try:
        yield
    except StepGapError:
        raise
    except Exception as error:
        raise failed(model, error) from error


def check_regression(model: ResidualModel, regression: Regression, points: Array) -> None:
    """Checks the predictions of a regression, for single points and for many together.

    Args:
        model: Its model.
        points: Points that it was fitted to; shape (N, d), N ≥ 1.

    Raises:
        ResidualError: A prediction is not finite or has the wrong shape, or a standard deviation is negative.
    """
    rows = np.linspace(0, len(points) - 1, min(len(points), CHECKED_POINTS)).astype(np.intp)
    _check(model.name, "noise_std", regression.noise_std, (), least=0)
    for at in (points[0], points[rows]):
        _check(model.name, "mean", regression.mean(at), at.shape[:-1])
        _check(model.name, "mean_gradient", regression.mean_gradient(at), at.shape)
        _check(model.name, "std", regression.std(at), at.shape[:-1], least=0)
        _check(model.name, "std_gradient", regression.std_gradient(at), at.shape)


def check_prediction(name: str, mean: Array, std: Array) -> None:
    """Checks means and standard deviations that a residual predicted, of any shape.

    Args:
        mean: Predicted errors.
        std: Their standard deviations.

    Raises:
        ResidualError: One of them is not finite, or a standard deviation is negative.
    """
    _check(name, "mean", mean, np.shape(mean))
    _check(name, "std", std, np.shape(std), least=0)


def _check(name: str, method: str, result: Any, shape: tuple[int, ...], least: float = -LARGEST_RETURNED) -> None:
    """Raises ResidualError unless these are numbers of this shape, from `least` to `LARGEST_RETURNED`."""
    values = np.asarray(result)
    returned = f"residual '{name}': its {method} returned"
    if values.dtype.kind not in "fiu":
        raise ResidualError(f"{returned} {result!r:.40}; it must return numbers of shape {shape}")
    if values.shape != shape:
        raise ResidualError(f"{returned} the shape {values.shape}; it must be {shape}")
    wrong = values[~((values >= least) & (values <= LARGEST_RETURNED))]
    if wrong.size:
        rule = "must be finite and not negative" if least == 0 else "must be finite"
        raise ResidualError(f"{returned} {wrong[0]:g}; it {rule}, and at most {LARGEST_RETURNED:g}")
