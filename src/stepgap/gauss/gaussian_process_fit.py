"""Hyper-parameters of a Gaussian process from data: the most probable ones, or those of MATLAB's `fitrgp`.

Equations marked RW are those of Rasmussen and Williams, Gaussian Processes for Machine Learning (2006).
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize

from stepgap.base.blas import one_blas_thread
from stepgap.base.normal import log_density
from stepgap.base.ranges import require
from stepgap.gauss.evidence import Evidence, LogParameters
from stepgap.gauss.gaussian_process import GaussianProcess, HyperParameters, checked_data, condition, condition_sparse
from stepgap.gauss.kernel import MATERN_52, Kernel
from stepgap.step import Array

Basis = Literal["constant", "linear"]
"""Basis of a Gaussian process besides f and noise: a constant, or a constant and slopes."""


EXACT_SIZE = 1000
"""Number of points above which hyper-parameters are searched on that many, evenly spaced, and a process is sparse.

On six functions with 1,100 and 2,000 points, the held-out error of such a sparse process is 0.98 to 1.01 times that of
the exact process with hyper-parameters from all points, which takes up to seven times as long.
"""

INDUCING_SIZES = (50, 100, 200, 400, 800)  # Numbers of inducing points that are tried, in turn

LEAST_GAIN = 0.005
"""Least gain of the mean log predictive density of held-out values that justifies more inducing points [nats]."""

COLD_START_SIZE = 100
"""Number of points above which the cold starts search on a part of the points; only the best uses all of them."""

LENGTH_SCALE_BOUNDS = (1e-2, 1e3)
"""Search range in input scales; for `fit_like_fitrgp` in units of its initial value."""

NOISE_RATIO_BOUNDS = (1e-4, 1e2)
"""Search range of noise over signal; its lower end keeps duplicated points well conditioned."""

SLOPE_RATIO_BOUNDS = (1e-3, 1e2)
"""Search range of the slopes' standard deviation over the signal's; at its lower end slopes are negligible."""

LEAST_NOISE = 1e-3  # Least standard deviation of the noise, in value scales; it is negligible in practice


def fit_gaussian_process(
    points: ArrayLike,
    values: ArrayLike,
    input_scale: ArrayLike,
    value_scale: float | None = None,
    *,
    basis: Basis = "constant",
    kernel: Kernel = MATERN_52,
    last_length_scale: float | None = None,
) -> GaussianProcess:
    """Fits a Gaussian process with the hyper-parameters of `fit_hyper_parameters`, whose arguments it has.

    Raises:
        ValueError: Data or scales are not finite, or their sizes do not fit.
    """
    hyper_parameters = fit_hyper_parameters(
        points, values, input_scale, value_scale, basis=basis, kernel=kernel, last_length_scale=last_length_scale
    )
    return condition_as_needed(points, values, input_scale, hyper_parameters, kernel)


def fit_hyper_parameters(
    points: ArrayLike,
    values: ArrayLike,
    input_scale: ArrayLike,
    value_scale: float | None = None,
    *,
    basis: Basis = "constant",
    kernel: Kernel = MATERN_52,
    last_length_scale: float | None = None,
) -> HyperParameters:
    """Finds the most probable hyper-parameters under weak priors, with one length scale per input.

    A priori log(length scale) ~ N(log 3, 1) for each input, log(noise/signal) ~ N(log 0.5, 1), log(signal) ~
    N(log(value_scale/4), 1) and, with the linear basis, log(slopes/signal) ~ N(0, 1), while β is flat and
    integrated out. Without these priors a fit to fewer than 50 points often mistakes noise for signal, and a fit to a
    single point, or to equal values, would have far too small standard deviations. The noise is at least
    0.001 value_scale. The search is deterministic: the same data give the same process. It uses at most `EXACT_SIZE`
    of the points.

    Args:
        points: Shape (N, d), N ≥ 1.
        values: Shape (N,).
        input_scale: Fixed size of each input, not taken from the data; shape (d,).
        value_scale: Fixed size of the values, such as half the range of use of the quantity they are errors of. By
            default half the range of the values: then equal values give tiny standard deviations.
        basis: Constant, or constant and slopes whose size is fitted.
        kernel: Covariance of f.
        last_length_scale: Length scale of the last input, where it is fixed and not searched.

    Raises:
        ValueError: Data or scales are not finite, or their sizes do not fit.
    """
    points, values, input_scale = checked_data(points, values, input_scale)
    if value_scale is None:
        value_scale = max(0.5 * float(np.ptp(values)), 1e-6 * float(np.abs(values).max()), 1e-12)
    require(0 < value_scale < math.inf, "value_scale", value_scale, "be positive and finite")
    some = searched_rows(len(values))
    inputs = points.shape[1]
    evidence = Evidence(
        points=points[some] / input_scale,
        values=values[some],
        value_scale=value_scale,
        length_scales=inputs,
        least_noise=LEAST_NOISE * value_scale,
        last_length_scale=last_length_scale,
        kernel=kernel,
    )
    log_parameters = _search(evidence, _starts(inputs, basis))
    probable = evidence.hyper_parameters(log_parameters)
    fitted = len(log_parameters.vector) + 1
    return _widened(probable, len(some), fitted)


def searched_rows(count: int) -> NDArray[np.intp]:
    """Rows, of `count`, on which hyper-parameters are searched."""
    return np.unique(np.linspace(0, count - 1, min(count, EXACT_SIZE)).astype(np.intp))


def _widened(probable: HyperParameters, size: int, fitted: int) -> HyperParameters:
    """Multiplies all variances by (N + 3p)/(N + p), for p fitted parameters; the mean does not change.

    The variance at the most probable parameters is too small, as is that of the residuals of a least-squares fit. There
    the variance is divided by N − p and intervals are those of Student's t: together a factor of some 1 + 2p/N. Here
    each prior counts like one more value. Without this factor, 95 % intervals contained 91 or 92 % of new values at
    N = 30.
    """
    wider = math.sqrt((size + 3 * fitted) / (size + fitted))
    stds = (wider * std for std in (probable.signal_std, probable.noise_std, probable.slope_std))
    return HyperParameters(probable.length_scale, *stds)


def fit_like_fitrgp(points: ArrayLike, values: ArrayLike) -> GaussianProcess:
    """Fits a Gaussian process as MATLAB's `fitrgp(…, 'constant', 'matern52')` does, for comparison.

    Maximum likelihood, one length scale for all inputs in their raw units, a single start from
    fitrgp's initial values (the mean standard deviation of the inputs; noise equal to signal) and its
    bound noise_std ≥ 0.01 · std(values). Its standard deviation is the plug-in one, `std`. Among inputs
    of different sizes the likelihood may grow with the length scale without limit: the search bounds limit it.

    Args:
        points: Shape (N, d), N ≥ 1.
        values: Shape (N,).
    """
    points, values, raw_units = checked_data(points, values, np.ones(np.shape(points)[-1:]))
    return condition_as_needed(points, values, raw_units, _like_fitrgp(points, values))


def _like_fitrgp(points: Array, values: Array) -> HyperParameters:
    some = searched_rows(len(values))
    points = points[some]
    values = values[some]
    spread, values_spread = (points.std(axis=0, ddof=1).mean(), values.std(ddof=1)) if len(values) > 1 else (0.0, 0.0)
    initial = spread if spread > 0 else 1.0
    least_noise = max(1e-6 * float(np.abs(values).max()), 1e-12, 0.01 * values_spread)
    evidence = Evidence(points / initial, values, None, 1, least_noise)
    fitted = evidence.hyper_parameters(_search(evidence, [LogParameters(np.zeros(1), 0.0)]))
    return HyperParameters(initial * fitted.length_scale, fitted.signal_std, fitted.noise_std)


def condition_as_needed(
    points: ArrayLike,
    values: ArrayLike,
    input_scale: ArrayLike,
    hyper_parameters: HyperParameters,
    kernel: Kernel = MATERN_52,
) -> GaussianProcess:
    """Conditions a process on the data, with more than `EXACT_SIZE` points a sparse one that has as many as it needs.

    Each inducing point is the point of largest variance given those before it (Burt and others, Convergence of
    Sparse Variational Inference in Gaussian Processes Regression, 2020). Their number grows as long as this
    improves the prediction of held-out values, every fifth one.

    Args:
        points: Shape (N, d), N ≥ 1.
        values: Shape (N,).
        input_scale: Fixed size of each input, not taken from the data; shape (d,).
        hyper_parameters: Hyper-parameters; `noise_std` must be positive.
        kernel: Covariance of f.
    """
    points, values, input_scale = checked_data(points, values, input_scale)
    if len(values) <= EXACT_SIZE:
        return condition(points, values, input_scale, hyper_parameters, kernel)
    held_out = np.arange(len(values)) % 5 == 4
    size = INDUCING_SIZES[0]
    best = -np.inf
    for candidate in INDUCING_SIZES:
        inducing = spread_points(points[~held_out], input_scale, hyper_parameters, candidate, kernel)
        process = condition_sparse(
            points[~held_out], values[~held_out], input_scale, hyper_parameters, inducing, kernel
        )
        std = process.kriging_std(points[held_out], include_noise=True)
        score = float(np.mean(log_density(values[held_out] - process.mean(points[held_out]), std)))
        if score < best + LEAST_GAIN:
            break
        size = candidate
        best = score
    inducing = spread_points(points, input_scale, hyper_parameters, size, kernel)
    return condition_sparse(points, values, input_scale, hyper_parameters, inducing, kernel)


def spread_points(
    points: Array, input_scale: Array, hyper_parameters: HyperParameters, count: int, kernel: Kernel = MATERN_52
) -> Array:
    """Selects at most `count` points, each where the variance of f given those before it is largest; shape (M, d).

    This is a pivoted Cholesky factorisation; it ends where only rounding errors remain.
    """
    scaled = points / (input_scale * hyper_parameters.length_scale)
    columns = np.empty((count, len(points)))
    remaining = np.ones(len(points))
    chosen = []
    # `columns` has the Cholesky factor of the chosen points, continued to all points, and `remaining` the variance of
    # f at each point given them [signal²]. A column costs O(N · row), and no matrix of all points is ever made.
    for row in range(min(count, len(points))):
        pick = int(np.argmax(remaining))
        if remaining[pick] < 1e-8:
            break
        correlation = kernel.covariance(((scaled - scaled[pick]) ** 2).sum(axis=1))
        columns[row] = (correlation - columns[:row, pick] @ columns[:row]) / np.sqrt(remaining[pick])
        remaining = remaining - columns[row] ** 2
        remaining[pick] = 0
        chosen.append(pick)
    return points[chosen]


def _starts(inputs: int, basis: Basis) -> list[LogParameters]:
    """Log parameters at which a search starts: all inputs equally relevant, then each input alone relevant.

    The first start alone ends up to 110 nats below the best if only one input is relevant and N ≤ 50.
    """
    length_scales = np.vstack([np.ones(inputs), np.where(np.eye(inputs) == 1, 0.5, 5.0)])
    noise_ratio, slope_ratio = np.log([0.2, 0.5]).tolist()
    slopes = (slope_ratio,) if basis == "linear" else ()
    return [LogParameters(np.log(start), noise_ratio, *slopes) for start in length_scales]


def _search(evidence: Evidence, starts: Sequence[LogParameters]) -> LogParameters:
    with one_blas_thread():
        if len(starts) > 1 and len(evidence.values) > COLD_START_SIZE:
            some = np.linspace(0, len(evidence.values) - 1, COLD_START_SIZE).astype(int)
            part = replace(evidence, points=evidence.points[some], values=evidence.values[some])
            starts = [_descend(part, starts, tolerance=1e-6)]
        return _descend(evidence, starts, tolerance=1e-8)


def _descend(evidence: Evidence, starts: Sequence[LogParameters], tolerance: float) -> LogParameters:
    """Best result of searches from `starts`; each stops when the loss falls by less than a fraction `tolerance`."""
    first = starts[0]

    def loss(vector: Array) -> tuple[float, Array]:
        value, gradient = evidence.loss(first.with_vector(vector))
        return value, gradient.vector

    bounds = [LENGTH_SCALE_BOUNDS] * evidence.length_scales + [NOISE_RATIO_BOUNDS, SLOPE_RATIO_BOUNDS]
    if evidence.last_length_scale is not None:
        bounds[evidence.length_scales - 1] = (evidence.last_length_scale, evidence.last_length_scale)
    log_bounds = np.log(bounds[: len(first.vector)])
    options = {"maxiter": 200, "ftol": tolerance, "gtol": 1e-3}
    ends = [
        minimize(loss, begin, jac=True, method="L-BFGS-B", bounds=log_bounds, options=options)
        for begin in np.clip([start.vector for start in starts], *log_bounds.T)
    ]
    return first.with_vector(min(ends, key=lambda end: end.fun).x)
