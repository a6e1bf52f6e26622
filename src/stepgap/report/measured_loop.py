"""Floquet multipliers of the closed loop from recorded steps: how an error evolves under the controller as deployed.

While the target stays the same, the error e = state − target (the state itself, where there is no target) follows
e⁺ = M e + c + noise, with the closed loop's derivative M and an offset c for each visit to a target. M is found by
least squares from the errors less their means over each visit. Such an estimate is biased by about −(1 + M) / T for
visits of T steps (Nickell, Biases in Dynamic Models with Fixed Effects, 1981), and the largest magnitude of several
multipliers is biased upwards. A bootstrap, which continues each visit from its first error with resampled noise,
estimates the bias and the interval together (the basic bootstrap interval; Davison and Hinkley, Bootstrap Methods and
Their Application, 1997, secs. 5.2 and 8.2). If all multipliers are nearly zero, the magnitudes are those of the
estimation errors, so lower ends near zero are too high.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stepgap.control.reference import same_target
from stepgap.learning.steps import Steps
from stepgap.step import Array

Mask = NDArray[np.bool_]

LOOP_DRAWS: Final = 500  # Number of bootstrap samples

FEWEST_DEGREES_OF_FREEDOM: Final = 20
"""Smallest number of degrees of freedom from which multipliers are computed."""


@dataclass(frozen=True, eq=False)
class MeasuredLoop:
    """The closed loop of a deployment, as its steps show it.

    Attributes:
        iteration: Number of the deployment.
        steps: Number of steps from which it was computed.
        largest: Largest magnitude of the Floquet multipliers, without the estimated bias.
        interval: Lower and upper ends of its 95 % confidence interval; shape (2,).
    """

    iteration: int
    steps: int
    largest: float
    interval: Array


def measured_loop(steps: Steps) -> MeasuredLoop | None:
    """Computes the largest multiplier of the closed loop from the steps of one deployment at unchanged targets.

    Returns:
        None if the steps are too few, or if their errors do not vary.
    """
    visits = [visit for visit in _visits(steps) if len(visit) > 2]
    count = sum(len(visit) - 1 for visit in visits)
    n = visits[0].shape[1] if visits else 0
    degrees_of_freedom = count - len(visits) - n
    if degrees_of_freedom < FEWEST_DEGREES_OF_FREEDOM:
        return None
    scale = np.concatenate(visits).std(axis=0)
    if not (scale > 0).all():
        return None
    errors, used = _padded([visit / scale for visit in visits])
    matrix = _fitted(errors, used)
    offsets = _visit_means(errors[:, 1:] - errors[:, :-1] @ matrix.T, used)
    noise = (errors[:, 1:] - errors[:, :-1] @ matrix.T - offsets)[used] * np.sqrt(count / degrees_of_freedom)
    largest = _largest_multiplier(matrix)
    drawn = _largest_multiplier(_fitted(_continued(errors, used, matrix, offsets, noise), used))
    low, high = np.percentile(drawn, [2.5, 97.5])
    ends = np.maximum([2 * largest - high, 2 * largest - low], 0.0)
    return MeasuredLoop(steps.iterations[0], count, float(max(2 * largest - drawn.mean(), 0.0)), ends)


def _largest_multiplier(matrix: Array) -> Array:
    """Largest magnitude of the eigenvalues of matrices (…, n, n), the Floquet multipliers; shape (…)."""
    return np.abs(np.linalg.eigvals(matrix)).max(axis=-1)


def _visits(steps: Steps) -> list[Array]:
    """Errors of consecutive states at an unchanged target, without that which the change left; shapes (T + 1, n).

    Where the command of the step before acts in a step, it is a part of the state; shapes (T + 1, n + m).
    """
    steps = steps.tracking()
    target = np.nan_to_num(steps.target)
    error = steps.state - target
    after = steps.next_state - target
    if steps.space.is_lagged:  # the loop goes through the command of the step before, too
        error = np.hstack([error, np.roll(steps.requested, 1, axis=0)])
        after = np.hstack([after, steps.requested])
    same = np.r_[False, same_target(steps.target[1:], steps.target[:-1])] & steps.follows
    used = same & np.isfinite(error).all(axis=1) & np.isfinite(after).all(axis=1)
    visits = list[list[Array]]()
    previous = False
    for row, is_used in enumerate(used):
        if is_used:
            if not previous:
                visits.append([error[row]])
            visits[-1].append(after[row])
        previous = bool(is_used)
    return [np.array(visit) for visit in visits]


def _padded(visits: Sequence[Array]) -> tuple[Array, Mask]:
    """Visits in one array (V, T + 1, n), filled with zeros, and which of their steps there are; shape (V, T)."""
    longest = max(map(len, visits))
    errors = np.stack([np.pad(visit, ((0, longest - len(visit)), (0, 0))) for visit in visits])
    used = np.arange(longest - 1) < np.array([[len(visit) - 1] for visit in visits])
    return errors, used


def _visit_means(values: Array, used: Mask) -> Array:
    """Means over the steps of each visit; (…, V, T, n) to (…, V, 1, n)."""
    weights = used[..., None] / used.sum(axis=1)[:, None, None]
    return np.sum(values * weights, axis=-2, keepdims=True)


def _fitted(errors: Array, used: Mask) -> Array:
    """M by least squares within the visits; (…, V, T + 1, n) to (…, n, n)."""
    before = np.where(used[..., None], errors[..., :-1, :] - _visit_means(errors[..., :-1, :], used), 0.0)
    # The means of what follows are not subtracted: these differences add up to zero in each visit.
    rows, after = (part.reshape(*part.shape[:-3], -1, part.shape[-1]) for part in (before, errors[..., 1:, :]))
    columns = np.swapaxes(rows, -1, -2)
    return np.swapaxes(np.asarray(np.linalg.solve(columns @ rows, columns @ after), float), -1, -2)


def _continued(errors: Array, used: Mask, matrix: Array, offsets: Array, noise: Array) -> Array:
    """Visits continued from their first errors with resampled noise; shape (LOOP_DRAWS, V, T + 1, n)."""
    chosen = np.random.default_rng(0).integers(len(noise), size=(LOOP_DRAWS, *used.shape))
    made = [np.broadcast_to(errors[:, 0], (LOOP_DRAWS, *errors[:, 0].shape))]
    for step in range(used.shape[1]):
        made.append(made[-1] @ matrix.T + offsets[:, 0] + noise[chosen[:, :, step]])
    return np.stack(made, axis=-2)
