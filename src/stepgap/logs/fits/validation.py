"""Cross-validation: how well each residual predicts held-out steps, and whether differences are significant.

Neighbouring steps are alike. So contiguous blocks are held out, or complete deployments, never single steps; and the
standard errors count blocks, not steps.

Residuals are compared alone, as functions of state and command: nothing is learned from one held-out step to the next.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from math import sqrt
from time import perf_counter
from typing import Final

import numpy as np
from scipy.special import stdtrit

from stepgap.base.errors import StepGapWarning
from stepgap.base.normal import INTERVAL_95
from stepgap.learning.observations import Observations
from stepgap.learning.residual import Residual, join_points
from stepgap.learning.residual_check import ResidualError, check_prediction
from stepgap.learning.residual_fit import fit_residual
from stepgap.learning.settings import AUTO
from stepgap.learning.steps import Labels
from stepgap.step import Array

FOLDS = 10
"""Number of parts that are held out in turn; standard errors are computed from at least as many blocks."""

LEAST_STEPS: Final = 2 * FOLDS  # Least number of steps for a comparison of residuals
TOGETHER: Final = 2000  # Number of steps whose predictions are computed together; it bounds the memory

CERTAIN: Final = 2.0
"""Least difference, in standard errors, for one residual to be called better than another."""

SIGNIFICANCE_LEVEL: Final = 0.05
"""Probability of calling equal residuals different, for independent and normal scores of blocks."""

OnFit = Callable[[int, int], None]
"""Called with the number of fits done and the number of all fits."""


@dataclass(frozen=True, eq=False)
class Folds:
    """Assignment of the steps to folds.

    Attributes:
        whole_deployments: Whether a fold consists of complete deployments; otherwise it is a contiguous block.
        fold: Number of the fold in which each step is held out; shape (N,).
        block: Number of the contiguous block, within a fold, that it counts with in standard errors; shape (N,).
    """

    whole_deployments: bool
    fold: Labels
    block: Labels

    @property
    def count(self) -> int:
        """Number of folds."""
        return int(self.fold.max()) + 1


def contiguous_folds(steps: int, number: int = FOLDS) -> Folds:
    """Divides the steps, in their order, into equal parts; 2 ≤ number ≤ steps."""
    parts = max(1, min(-(-FOLDS // number), steps // number))
    block = np.arange(steps) * (number * parts) // steps
    return Folds(False, block // parts, block)


def deployment_folds(deployment: Labels) -> Folds:
    """Makes one fold of each of several deployments; of more than `FOLDS`, one of each of `FOLDS` groups of them."""
    names, position = np.unique(deployment, return_inverse=True)
    number = min(len(names), FOLDS)
    fold = position * number // len(names)
    block = np.zeros(len(position), np.intp)
    blocks = 0
    for part in range(number):
        rows = np.flatnonzero(fold == part)
        parts = min(-(-FOLDS // number), len(rows))
        block[rows] = np.arange(len(rows)) * parts // len(rows) + blocks
        blocks += parts
    return Folds(True, fold, block)


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Predictions of a residual at held-out steps.

    Attributes:
        kind: Name of the residual.
        error: Actual − nominal next state; shape (N, n).
        mean: Predicted error; shape (N, n).
        std: Standard deviation with noise, zero for a residual without one; shape (N, n).
        seconds: Time of one fit [s].
    """

    kind: str
    error: Array
    mean: Array
    std: Array
    seconds: float

    @property
    def remaining(self) -> Array:
        """Error that remains after the correction; shape (N, n)."""
        return self.error - self.mean

    @property
    def rmse(self) -> Array:
        """Root mean square of the remaining error; shape (n,)."""
        return np.sqrt(np.mean(self.remaining**2, axis=0))

    @property
    def coverage(self) -> Array:
        """Fraction of steps within the 95 % interval; NaN without standard deviations; shape (n,)."""
        inside = np.abs(self.remaining) <= INTERVAL_95 * self.std
        return np.where((self.std > 0).all(axis=0), np.mean(inside, axis=0), np.nan)


@dataclass(frozen=True)
class Reduction:
    """Fraction by which one residual's error is smaller than another's.

    Attributes:
        value: Reduction of the root-mean-square error; negative if it is larger, −∞ if the other error is zero.
        standard_error: Standard error by the jackknife over blocks.
        blocks: Number of blocks.
    """

    value: float
    standard_error: float
    blocks: int

    @property
    def half_width(self) -> float:
        """Half the width of the 95 % interval: Student's t standard errors, 2.26 for ten blocks, at least `CERTAIN`."""
        quantile = float(stdtrit(self.blocks - 1, 1 - SIGNIFICANCE_LEVEL / 2))
        return max(CERTAIN, quantile) * self.standard_error

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the reduction."""
        return self.value - self.half_width, self.value + self.half_width

    @property
    def certain(self) -> bool:
        """Whether the 95 % interval lies above zero."""
        return self.value > self.half_width


def reduction(one: HeldOut, other: HeldOut, block: Labels, coordinates: Sequence[int]) -> Reduction:
    """Computes by how much `one` is better than `other`, paired step by step.

    For several coordinates it is the reduction of the root of the mean, over coordinates, of the ratios of the squared
    errors, so that units do not matter.
    """
    columns = list(coordinates)
    blocks = int(block.max()) + 1
    sums = [np.zeros((blocks, len(columns))) for _ in range(2)]
    for total, held_out in zip(sums, (one, other), strict=True):
        np.add.at(total, block, held_out.remaining[:, columns] ** 2)
    value = _reduction(*(total.sum(axis=0) for total in sums))
    without = np.array([_reduction(*(np.delete(total, out, 0).sum(axis=0) for total in sums)) for out in range(blocks)])
    spread = float(np.sum((without - without.mean()) ** 2)) if np.isfinite(without).all() else np.inf
    return Reduction(value, sqrt((blocks - 1) / blocks * spread), blocks)


def _reduction(one: Array, other: Array) -> float:
    """Reduction from the sums of squares of each coordinate."""
    ratios = np.where(one == other, 1.0, np.inf)
    np.divide(one, other, out=ratios, where=(one != other) & (other > 0))
    return 1 - sqrt(np.mean(ratios))


@dataclass(frozen=True)
class Best:
    """The residual that predicts held-out steps best, all state coordinates together.

    Attributes:
        kind: Its name.
        gain: Reduction of the error without a correction.
        alike: Other residuals than which it is not certainly better, besides `none`.
    """

    kind: str
    gain: Reduction
    alike: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Validation:
    """Result of the cross-validation of several residuals.

    Attributes:
        folds: Which steps were held out together.
        held_out: Predictions by name of the residual, from simple to complex.
    """

    folds: Folds
    held_out: Mapping[str, HeldOut]

    def reduction(self, kind: str, other: str, coordinates: Sequence[int]) -> Reduction:
        """Computes by how much one residual is better than another in these state coordinates."""
        return reduction(self.held_out[kind], self.held_out[other], self.folds.block, coordinates)

    @property
    def best(self) -> Best:
        """The residual with the least error, the simplest of equal ones; never `auto`, which is one of the others."""
        everything = range(self.held_out["none"].error.shape[1])
        gain = {kind: self.reduction(kind, "none", everything) for kind in self.held_out if kind != AUTO}
        best = max(gain, key=lambda kind: gain[kind].value)
        others = (kind for kind in gain if kind not in ("none", best))
        alike = (kind for kind in others if not self.reduction(best, kind, everything).certain)
        return Best(best, gain[best], tuple(alike))


def validate(
    kinds: Sequence[str], steps: Observations, folds: Folds, on_fit: OnFit = lambda done, total: None
) -> Validation:
    """Holds out every fold from every residual; a `StepGapWarning` names each that is left out because it fails.

    Args:
        kinds: Names of the residuals, from simple to complex.
        steps: Errors of the nominal map at the steps.
    """
    held = [folds.fold == number for number in range(folds.count)]
    parts = [(steps.selected(~rows), steps.selected(rows)) for rows in held]
    order = np.argsort(folds.fold, kind="stable")
    return Validation(folds, _hold_out(kinds, parts, np.argsort(order), on_fit))


def validate_on(
    kinds: Sequence[str], steps: Observations, test: Observations, on_fit: OnFit = lambda done, total: None
) -> Validation:
    """Fits every residual to some steps and predicts others, `test`, such as those of another day or robot.

    These count in blocks for the standard errors; the arguments are otherwise those of `validate`.
    """
    together = replace(contiguous_folds(len(test), FOLDS), fold=np.zeros(len(test), np.intp))
    return Validation(together, _hold_out(kinds, [(steps, test)], np.arange(len(test)), on_fit))


def _hold_out(
    kinds: Sequence[str], parts: Sequence[tuple[Observations, Observations]], order: Labels, on_fit: OnFit
) -> dict[str, HeldOut]:
    """Fits each residual to the first steps of each part, predicts the second ones, and puts these in order."""
    error = np.concatenate([held.error for _, held in parts])[order]
    held_out: dict[str, HeldOut] = {}
    done = count(1)
    for kind in kinds:
        seconds = 0.0
        predictions: list[tuple[Array, Array]] = []
        try:
            for fitted, held in parts:
                begin = perf_counter()
                residual = fit_residual(kind, fitted)
                seconds += perf_counter() - begin
                predictions.append(_predict(residual, held))
                on_fit(next(done), len(kinds) * len(parts))
        except ResidualError as failure:  # the others are compared
            warnings.warn(f"left out: {failure}", StepGapWarning, stacklevel=3)
            continue
        mean, std = (np.concatenate(values)[order] for values in zip(*predictions, strict=True))
        held_out[kind] = HeldOut(kind, error, mean, std, seconds / len(parts))
    return held_out


def _predict(residual: Residual, steps: Observations) -> tuple[Array, Array]:
    """Means and standard deviations, with noise, of the errors of steps; shapes (N, n)."""
    points = join_points(steps.state, steps.command)
    parts = np.array_split(points, -(-len(points) // TOGETHER))
    mean = np.concatenate([residual.mean(part) for part in parts])
    std = np.concatenate([residual.std(part, include_noise=True) for part in parts])
    check_prediction(residual.kind, mean, std)
    return mean, std
