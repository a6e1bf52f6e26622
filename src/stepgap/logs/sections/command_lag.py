"""How long after a command the motion follows: a log whose motion comes first has clocks that differ."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from stepgap.logs.sections.held_commands import HeldCommands
from stepgap.step import Array

CELLS: Final = 10
"""Number of parts of a step in which the motion is compared with the command."""

MOST_CELLS: Final = 6000
"""Number of these parts, from the begin of the log on, that are compared."""

EXPLAINED: Final = 0.2
"""Least part of the variance of a velocity that its commands must explain, for the lag to be known."""


def command_lag(cells: Array, motion: Sequence[Array], commands: HeldCommands) -> float:
    """The lag of the commands with which a linear function of them explains the motion best [s].

    Args:
        cells: Times that divide the log evenly [s]; shape (G + 1,).
        motion: Mean of each velocity between these times, NaN where it is not known; each of shape (G,).
        commands: The commands.

    Returns:
        One of the lags up to a step, positive where the motion comes later; NaN if the motion does not follow them.
    """
    lags = np.arange(-CELLS, CELLS + 1) * float(cells[1] - cells[0])
    middle = (cells[1:] + cells[:-1]) / 2
    at = commands.at(middle - lags[:, None])
    inputs = np.where((at >= 0)[..., None], commands.values[at], np.nan)
    velocities = np.stack(motion, axis=-1)
    known = np.isfinite(inputs).all(axis=(0, 2)) & np.isfinite(velocities).all(axis=1)
    spread = velocities[known].std(axis=0) if known.any() else np.zeros(len(motion))
    if not (spread > 0).all() or known.sum() < 2 * CELLS:
        return np.nan
    wanted = (velocities[known] - velocities[known].mean(axis=0)) / spread
    unexplained = [_unexplained(each[known], wanted) for each in inputs]
    best = int(np.argmin(unexplained))
    return float(lags[best]) if unexplained[best] < 1 - EXPLAINED else np.nan


def _unexplained(inputs: Array, wanted: Array) -> float:
    """Mean square of what an affine function of the inputs leaves of outputs with variance 1."""
    basis = np.column_stack([inputs, np.ones(len(inputs))])
    return float(np.mean((wanted - basis @ np.linalg.lstsq(basis, wanted, rcond=None)[0]) ** 2))
