"""Suspicious rows of a log: a few numbers that are wrong would decide which errors can be learned.

Two kinds are found. A row is *far* if a number of it lies far outside of the same numbers of all other rows: the state,
the command, or what should come next. It is *improbable* if its held-out error is much larger than those of other
rows, and alone: not like that of the step before or after it, or of most similar steps. What lasts or returns is no
wrong number.
"""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stepgap.learning.observations import Observations
from stepgap.learning.steps import Steps
from stepgap.logs.fits.validation import LEAST_STEPS, Validation
from stepgap.step import Array

FAR: Final = 2.0
"""A number is far if its distance from the middle nine tenths of all is more than this multiple of their range,"""

FAR_FROM_CONSTANT: Final = 50.0
"""which counts as this multiple of their value if they are all equal."""

LARGE: Final = 5.0
"""A held-out error is improbable if it is more than this multiple of a typical one, or of its standard deviation."""

_LEAST_STD: Final = 0.02
"""No prediction is taken to be more accurate than this [half ranges]; else a log without noise had suspicious rows."""

_SIMILAR: Final = 0.2
"""Steps are similar if their states and commands differ by less in every coordinate [half ranges]."""

MOST_SUSPICIOUS: Final = 0.1
"""If a larger part of the rows seemed to be suspicious, the others are no measure of them, and none is."""

Reasons = dict[int, str]
"""What is suspicious in a row, by its index."""


def far_rows(steps: Steps) -> Reasons:
    """Rows with a number far outside of the others."""
    found: Reasons = {}
    for name, values in _columns(steps):
        low, middle, high = np.quantile(values, (0.05, 0.5, 0.95), method="nearest")
        width = high - low or FAR_FROM_CONSTANT * abs(middle)
        far = np.maximum(low - values, values - high) > FAR * width
        if width > 0 and far.sum() <= MOST_SUSPICIOUS * len(values):
            for row in np.flatnonzero(far):
                found.setdefault(int(row), f"{name} = {values[row]:.4g}, others {low:.3g} to {high:.3g}")
    return _few(found, len(steps))


def improbable_rows(observed: Observations, follows: NDArray[np.bool_], validation: Validation) -> Reasons:
    """Rows with a held-out error much larger than the others, by the residual that predicts most rows best.

    Args:
        observed: The N steps.
        follows: Whether each is the step after the one in the row above; shape (N,).
        validation: Predictions of their errors.
    """
    ratios = np.empty_like(observed.error)
    for column, scale in enumerate(observed.space.state_scale):
        typical = {kind: np.median(np.abs(held.remaining[:, column])) for kind, held in validation.held_out.items()}
        best = validation.held_out[min(typical, key=lambda kind: float(typical[kind]))]
        std = np.maximum(1.4826 * typical[best.kind], _LEAST_STD * scale)
        ratios[:, column] = best.remaining[:, column] / np.maximum(std, best.std[:, column])
    space = observed.space
    rows = np.flatnonzero(large_and_alone(ratios, follows, space.scaled_inputs(observed.state, observed.command)))
    errors = (_error_of(space.state_names, observed.error[row], np.abs(ratios[row])) for row in rows)
    return _few(dict(zip(rows.tolist(), errors, strict=True)), len(observed))


def large_and_alone(ratios: Array, follows: NDArray[np.bool_], points: Array) -> NDArray[np.bool_]:
    """Which steps have an error that is `LARGE`, and alone.

    Args:
        ratios: Error of the prediction of each step from the others, in typical ones; shape (N, n).
        follows: Whether each step is the one after the step in the row above; shape (N,).
        points: State and command of each step; shape (N, n + m) [half ranges].

    Returns:
        Shape (N,). An error is not alone if that of its neighbour in time is large, too, in the same direction, or if
        that of more than half of all similar steps is.
    """
    signs = np.where(np.abs(ratios) > LARGE, np.sign(ratios), 0)
    same = ((signs[1:] == signs[:-1]) & (signs[1:] != 0)).any(axis=1) & follows[1:]
    alone = signs.any(axis=1) & ~np.append(False, same) & ~np.append(same, False)
    for row in np.flatnonzero(alone):
        similar = (np.abs(points - points[row]) < _SIMILAR).all(axis=1)
        alike = (signs[similar] == signs[row])[:, signs[row] != 0].any(axis=1).sum()
        alone[row] = alike <= max(1, similar.sum() / 2)
    return alone


def _error_of(names: tuple[str, ...], error: Array, ratio: Array) -> str:
    worst = int(ratio.argmax())
    return f"error of {names[worst]} {error[worst]:.4g}, {ratio[worst]:.0f} times a typical one"


def _few(found: Mapping[int, str], count: int) -> Reasons:
    return dict(found) if len(found) <= min(MOST_SUSPICIOUS * count, count - LEAST_STEPS) else {}


def _columns(steps: Steps) -> Iterator[tuple[str, Array]]:
    """Yields the numbers by which a row may be far, with their names."""
    state, command = steps.space.state_names, steps.space.command_names
    parts = {"": (state, steps.state), " ": (command, steps.requested), "next ": (state, steps.next_state)}
    for word, (names, values) in (parts | {"predicted ": (state, steps.predicted)}).items():
        yield from zip((f"{word}{name}".lstrip() for name in names), values.T, strict=True)
