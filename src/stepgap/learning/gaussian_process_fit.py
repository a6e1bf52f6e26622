"""Hyper-parameters of a Gaussian process from data: the most probable ones, or those of MATLAB's `fitrgp`.

Equations marked RW are those of Rasmussen and Williams, Gaussian Processes for Machine Learning (2006).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import get_lapack_funcs
from scipy.optimize import minimize
from scipy.spatial.distance import pdist, squareform
from threadpoolctl import threadpool_limits

from stepgap.learning.gaussian_process import (
    GaussianProcess,
    HyperParameters,
    LeastSquares,
    checked_data,
    condition,
    kernel_descent,
    least_squares_fit,
)
from stepgap.step import Array

COLD_START_SIZE = 200
"""Most points on which the cold starts compete; with more, only the winner goes on with all points."""

LENGTH_SCALE_BOUNDS = (1e-2, 1e3)
"""Search range in input scales; for `fit_like_fitrgp` in units of its initial value."""

NOISE_RATIO_BOUNDS = (1e-4, 1e2)
"""Search range of noise over signal; its lower end keeps duplicated points well conditioned."""

(_potri,) = get_lapack_funcs(("potri",), dtype=np.float64)


def fit_gaussian_process(points: ArrayLike, values: ArrayLike, input_scale: ArrayLike) -> GaussianProcess:
    """Most probable hyper-parameters under weak priors, one length scale per input.

    A priori log(length scale) ~ N(log 3, 1) for each input and log(noise/signal) ~ N(log 0.5, 1), while
    log(signal) and β are flat. Without these priors a fit to fewer than 50 points often takes noise for
    signal. The search is deterministic: the same data give the same process. Where the values do not
    vary (N = 1, say) nothing tells their spread: the standard deviations are then tiny but positive.

    Args:
        points: Shape (N, d), N ≥ 1.
        values: Shape (N,).
        input_scale: Fixed size of each input, not taken from the data; shape (d,).
    """
    points, values, input_scale = checked_data(points, values, input_scale)
    least_noise = _least_noise(values)
    starts = cold_starts(points.shape[1])
    if len(values) > COLD_START_SIZE:
        some = np.linspace(0, len(values) - 1, COLD_START_SIZE).astype(int)
        differences = squared_differences(points[some] / input_scale)
        starts = [_search(Evidence(differences, values[some], least_noise, with_prior=True), starts)]
    evidence = Evidence(squared_differences(points / input_scale), values, least_noise, with_prior=True)
    log_parameters = _search(evidence, starts)
    hyper_parameters = HyperParameters(np.exp(log_parameters[:-1]), *evidence.signal_and_noise(log_parameters))
    return condition(points, values, input_scale, hyper_parameters)


def fit_like_fitrgp(points: ArrayLike, values: ArrayLike) -> GaussianProcess:
    """Hyper-parameters as MATLAB's `fitrgp(…, 'constant', 'matern52')` chooses them, for comparison.

    Maximum likelihood, one length scale for all inputs in their raw units, a single start from
    fitrgp's initial values (the mean standard deviation of the inputs; noise equal to signal) and its
    bound noise_std ≥ 0.01 · std(values). Its standard deviation is the plug-in one, `std`. Among inputs
    of unlike sizes the likelihood may grow for ever with the length scale: the search bounds end it.

    Args:
        points: Shape (N, d), N ≥ 1.
        values: Shape (N,).
    """
    points, values, raw_units = checked_data(points, values, np.ones(np.shape(points)[-1:]))
    spread, values_spread = (points.std(axis=0, ddof=1).mean(), values.std(ddof=1)) if len(values) > 1 else (0.0, 0.0)
    initial = spread if spread > 0 else 1.0
    differences = squared_differences(points / initial).sum(axis=0, keepdims=True)
    least_noise = max(_least_noise(values), 0.01 * values_spread)
    evidence = Evidence(differences, values, least_noise, with_prior=False)
    log_parameters = _search(evidence, [np.zeros(2)])
    length_scale = np.full(points.shape[1], initial * np.exp(log_parameters[0]))
    hyper_parameters = HyperParameters(length_scale, *evidence.signal_and_noise(log_parameters))
    return condition(points, values, raw_units, hyper_parameters)


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the data say of log parameters: log length scales and log(noise/signal).

    The signal is not among them: for given parameters the most likely one has a closed form.

    Attributes:
        differences: Squared differences of every pair of points, input by input; shape (p, N(N−1)/2).
            A single row, summed over the inputs, gives one common length scale.
        values: Shape (N,).
        least_noise: Lower bound of the noise's standard deviation.
        with_prior: Whether the log prior is added to the log likelihood.
    """

    differences: Array
    values: Array
    least_noise: float
    with_prior: bool

    def loss(self, log_parameters: Array) -> tuple[float, Array]:
        """Negative log posterior and its gradient (p + 1,) (RW Eqs. 5.8, 5.9)."""
        distance, solved, signal = self._solve(log_parameters)
        weights, scaled_weights = solved.weights, solved.weights / signal**2
        inverse, _ = _potri(solved.factor, lower=1)
        # potri fills the lower triangle in Fortran order: the upper one in C order, which squareform reads.
        excess = squareform(np.outer(weights, scaled_weights) - inverse.T, checks=False)
        by_length_scale = self.differences @ (excess * kernel_descent(distance))
        by_ratio = np.exp(2 * log_parameters[-1]) * (weights @ scaled_weights - np.trace(inverse))
        # This part is zero except where the least noise binds: there the signal follows from the ratio.
        by_ratio += len(weights) - solved.misfit / signal**2
        log_posterior = solved.log_likelihood(signal)
        gradient = np.append(np.exp(-2 * log_parameters[:-1]) * by_length_scale, by_ratio)
        if self.with_prior:
            deviation = log_parameters - np.log([*[3.0] * len(self.differences), 0.5])
            log_posterior -= 0.5 * float(deviation @ deviation)
            gradient -= deviation
        return -log_posterior, -gradient

    def signal_and_noise(self, log_parameters: Array) -> tuple[float, float]:
        """Most likely signal_std, and the noise_std that belongs to it."""
        _, _, signal = self._solve(log_parameters)
        return signal, signal * math.exp(log_parameters[-1])

    def _solve(self, log_parameters: Array) -> tuple[Array, LeastSquares, float]:
        """√5 r of every pair of points, the least squares with it, and the most likely signal_std."""
        ratio = math.exp(log_parameters[-1])
        distance = np.sqrt(5 * (np.exp(-2 * log_parameters[:-1]) @ self.differences))
        solved = least_squares_fit(distance, ratio, self.values)
        return distance, solved, max(math.sqrt(solved.misfit / len(self.values)), self.least_noise / ratio)


def cold_starts(inputs: int) -> list[Array]:
    """Log parameters from which a search begins: all inputs alike, then each one alone decisive; shapes (d + 1,).

    The first alone ends up to 110 nats short of the best where one input is decisive and N ≤ 50.
    """
    length_scales = np.vstack([np.ones(inputs), np.where(np.eye(inputs) == 1, 0.5, 5.0)])
    return [np.log([*start, 0.2]) for start in length_scales]


def _search(evidence: Evidence, starts: Sequence[Array]) -> Array:
    """Log parameters of the least loss that is reached from `starts`; shape (p + 1,)."""
    bounds = np.log([*[LENGTH_SCALE_BOUNDS] * len(evidence.differences), NOISE_RATIO_BOUNDS])
    # The loss counts nats: 1e-8 of some hundreds or thousands is far less than matters.
    options = {"maxiter": 200, "ftol": 1e-8, "gtol": 1e-3}
    with threadpool_limits(limits=1, user_api="blas"):  # more threads only wait for each other at these sizes
        ends = [
            minimize(evidence.loss, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
            for start in starts
        ]
    return min(ends, key=lambda end: end.fun).x


def squared_differences(points: Array) -> Array:
    """Squared difference of every pair of points (N, d), input by input; shape (d, N(N−1)/2)."""
    return np.array([pdist(column[:, None], "sqeuclidean") for column in points.T], float)


def _least_noise(values: Array) -> float:
    """A noise that matters to nobody, so that values which do not vary keep a positive one."""
    return max(1e-6 * float(np.abs(values).max()), 1e-12)
