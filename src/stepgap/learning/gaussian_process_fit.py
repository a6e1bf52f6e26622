"""Hyper-parameters of a Gaussian process from data: the most probable ones, or those of MATLAB's `fitrgp`.

Equations marked RW are those of Rasmussen and Williams, Gaussian Processes for Machine Learning (2006).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal, TypedDict, final

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import get_lapack_funcs
from scipy.optimize import minimize
from scipy.spatial.distance import pdist
from scipy.special import wrightomega
from threadpoolctl import ThreadpoolController

from stepgap.learning.cholesky import factorise
from stepgap.learning.covariance import covariance_matrix, evidence_gradient, kernel, kernel_descent
from stepgap.learning.gaussian_process import GaussianProcess, HyperParameters, checked_data, condition, require
from stepgap.learning.least_squares import LeastSquares, fit_least_squares
from stepgap.step import Array

Basis = Literal["constant", "linear"]
"""What a Gaussian process has besides f and noise: a constant, or a constant and slopes."""


class Search(TypedDict, total=False):
    """What else may be said of a search for hyper-parameters; see `fit_gaussian_process`."""

    basis: Basis
    start: HyperParameters | None
    last_length_scale: float | None


COLD_START_SIZE = 100
"""Most points on which the starts compete; with more, only the best goes on with all points."""

LENGTH_SCALE_BOUNDS = (1e-2, 1e3)
"""Search range in input scales; for `fit_like_fitrgp` in units of its initial value."""

NOISE_RATIO_BOUNDS = (1e-4, 1e2)
"""Search range of noise over signal; its lower end keeps duplicated points well conditioned."""

SLOPE_RATIO_BOUNDS = (1e-3, 1e2)
"""Search range of the slopes' standard deviation over the signal's; at its lower end slopes are nothing."""

PRIOR_LENGTH_SCALE, PRIOR_NOISE_RATIO, PRIOR_SLOPE_RATIO = 3.0, 0.5, 1.0
"""Medians of the priors, in input scales and signals."""

PRIOR_SIGNAL = 0.25
"""Median of the prior of the signal, in value scales."""

LEAST_NOISE = 1e-3
"""Least standard deviation of the noise, in value scales: it matters to nobody."""

(_potri,) = get_lapack_funcs(("potri",), dtype=np.float64)


def fit_gaussian_process(
    points: ArrayLike,
    values: ArrayLike,
    input_scale: ArrayLike,
    value_scale: float | None = None,
    *,
    basis: Basis = "constant",
    start: HyperParameters | None = None,
    last_length_scale: float | None = None,
) -> GaussianProcess:
    """Most probable hyper-parameters under weak priors, one length scale per input.

    A priori log(length scale) ~ N(log 3, 1) for each input, log(noise/signal) ~ N(log 0.5, 1), log(signal) ~
    N(log(value_scale/4), 1) and, with the linear basis, log(slopes/signal) ~ N(0, 1), while β is flat and
    integrated out. Without these priors a fit to fewer than 50 points often takes noise for signal, and one to a
    single point, or to values that happen to be the same, would be sure of what it cannot know. The noise is at
    least 0.001 value_scale. The search is deterministic: the same data give the same process.

    Args:
        points: Shape (N, d), N ≥ 1.
        values: Shape (N,).
        input_scale: Fixed size of each input, not taken from the data; shape (d,).
        value_scale: Fixed size of the values, such as half the range of use of what they are errors of. Without
            it half the range of the values: then those that do not vary leave standard deviations that are tiny.
        basis: Constant, or constant and slopes whose size the data choose.
        start: Hyper-parameters of a former fit, from which this one then begins, besides a single cold start.
        last_length_scale: Length scale of the last input, where it is given and not to be searched.

    Raises:
        ValueError: Data or scales are not finite, or their sizes do not fit.
    """
    points, values, input_scale = checked_data(points, values, input_scale)
    if value_scale is None:
        value_scale = max(0.5 * float(np.ptp(values)), 1e-6 * float(np.abs(values).max()), 1e-12)
    require(0 < value_scale < math.inf, "value_scale", "positive and finite")
    least_noise = LEAST_NOISE * value_scale
    evidence = Evidence(points / input_scale, values, points.shape[1], least_noise, value_scale, last_length_scale)
    cold = cold_starts(points.shape[1], basis)
    if start is None:
        log_parameters = _search(evidence, cold)
    else:
        log_parameters = _search(evidence, cold[:1], [_log_parameters(start, basis)])
    found = evidence.hyper_parameters(log_parameters)
    return condition(points, values, input_scale, _widened(found, len(values), len(log_parameters) + 1))


def _widened(found: HyperParameters, size: int, fitted: int) -> HyperParameters:
    """All variances times (N + 3p)/(N + p), for p fitted parameters; the mean stays as it is.

    The most probable parameters leave too little variance, as residuals of a least-squares fit do, whose variance is
    therefore divided by N − p and whose intervals are those of Student's t: together some 1 + 2p/N. Here each prior
    counts like one more value. Without it 95 % intervals held 91 or 92 % of new values at N = 30.
    """
    wider = math.sqrt((size + 3 * fitted) / (size + fitted))
    stds = (wider * std for std in (found.signal_std, found.noise_std, found.slope_std))
    return HyperParameters(found.length_scale, *stds)


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
    least_noise = max(1e-6 * float(np.abs(values).max()), 1e-12, 0.01 * values_spread)
    evidence = Evidence(points / initial, values, 1, least_noise, None)
    found = evidence.hyper_parameters(_search(evidence, [np.zeros(2)]))
    hyper_parameters = HyperParameters(initial * found.length_scale, found.signal_std, found.noise_std)
    return condition(points, values, raw_units, hyper_parameters)


@final
@dataclass(frozen=True, eq=False)
class Evidence:
    """What the data say of log parameters: log length scales, log(noise/signal) and perhaps log(slopes/signal).

    The signal is not among them: for given parameters the most probable one has a closed form.

    Attributes:
        points: In input scales; shape (N, d).
        values: Shape (N,).
        length_scales: How many there are: d, or 1 in common for all inputs.
        least_noise: Lower bound of the noise's standard deviation.
        value_scale: Scale of the signal's prior. None: no priors, and β not integrated out: maximum likelihood.
        last_length_scale: Length scale of the last input, where it is not searched.
    """

    points: Array
    values: Array
    length_scales: int
    least_noise: float
    value_scale: float | None
    last_length_scale: float | None = None

    def loss(self, log_parameters: Array) -> tuple[float, Array]:
        """Negative log posterior and its gradient, of the shape of the parameters (RW Eqs. 2.45, 5.8, 5.9)."""
        distance, lean, solved, signal = self._solve(log_parameters)
        explained = np.zeros((len(self.values), 2))
        explained[:, 0] = solved.weights / signal
        log_posterior = solved.log_likelihood(signal)
        prior, prior_gradient = 0.0, np.zeros(len(log_parameters))
        if self.value_scale is not None:
            by_ones = solved.factor.solve_transposed(solved.basis)
            explained[:, 1] = by_ones / math.sqrt(by_ones.sum())
            log_posterior = solved.log_evidence(signal)
            deviation = log_parameters - _prior_median(len(self.points[0]), len(log_parameters))
            prior = -0.5 * float(deviation @ deviation) - 0.5 * self._surprise(signal) ** 2
            prior_gradient = -deviation
        inverse, _ = _potri(solved.factor.base, lower=1)
        # potri fills the lower triangle in Fortran order: the upper one in C order.
        by_length_scale, by_lean, by_noise = evidence_gradient(
            inverse.T, explained, kernel_descent(distance), self.points, lean
        )
        lengths = log_parameters[: self.length_scales]
        by_lengths = np.exp(-2 * lengths) * by_length_scale.reshape(self.length_scales, -1).sum(axis=1)
        by_ratio = np.exp(2 * log_parameters[self.length_scales]) * by_noise
        # This part is zero except where the least noise binds: there the signal follows from the ratio.
        by_ratio += self._freedom - solved.misfit / signal**2
        if self.value_scale is not None:
            by_ratio += self._surprise(signal)
        gradient = np.concatenate([by_lengths, [by_ratio], [by_lean] * (len(log_parameters) - len(lengths) - 1)])
        return -log_posterior - prior, -gradient - prior_gradient

    def hyper_parameters(self, log_parameters: Array) -> HyperParameters:
        """The parameters with the most probable signal."""
        _, _, _, signal = self._solve(log_parameters)
        ratio, slope = (*np.exp(log_parameters[self.length_scales :]), 0.0)[:2]
        length_scale = np.broadcast_to(np.exp(log_parameters[: self.length_scales]), self.points.shape[1:]).copy()
        return HyperParameters(length_scale, signal, signal * float(ratio), signal * float(slope))

    @property
    def _freedom(self) -> int:
        """How many values tell of the signal: one is spent on β where it is integrated out."""
        return len(self.values) - (self.value_scale is not None)

    def _surprise(self, signal: float) -> float:
        """Deviation of log(signal) from the median of its prior."""
        assert self.value_scale is not None
        return math.log(signal / (PRIOR_SIGNAL * self.value_scale))

    def _solve(self, log_parameters: Array) -> tuple[Array, Array, LeastSquares, float]:
        """√5 r of every pair of points, the lean of the slopes, the least squares and the most probable signal_std."""
        ratio, slope = (*np.exp(log_parameters[self.length_scales :]), 0.0)[:2]
        distance = np.sqrt(5 * pdist(self.points * np.exp(-log_parameters[: self.length_scales]), "sqeuclidean"))
        lean = (self.points - self.points[0]) * slope
        solved = fit_least_squares(factorise(covariance_matrix(kernel(distance), lean, ratio**2)), self.values)
        return distance, lean, solved, max(self.signal(solved.misfit), self.least_noise / ratio)

    def signal(self, misfit: float) -> float:
        """Most probable signal_std: with log s ~ N(log m, 1) the root of misfit/s² = freedom + log(s/m)."""
        if self.value_scale is None:
            return math.sqrt(misfit / self._freedom)
        median, twice = PRIOR_SIGNAL * self.value_scale, 2.0 * self._freedom
        omega = float(wrightomega(np.log(2 * misfit / median**2) + twice)) if misfit > 0 else 0.0
        return median * math.exp(0.5 * (omega - twice))


def cold_starts(inputs: int, basis: Basis = "constant") -> list[Array]:
    """Log parameters from which a search begins: all inputs alike, then each one alone decisive.

    The first alone ends up to 110 nats short of the best where one input is decisive and N ≤ 50.
    """
    length_scales = np.vstack([np.ones(inputs), np.where(np.eye(inputs) == 1, 0.5, 5.0)])
    rest = [0.2] if basis == "constant" else [0.2, 0.5]
    return [np.log([*start, *rest]) for start in length_scales]


def _log_parameters(hyper_parameters: HyperParameters, basis: Basis) -> Array:
    """Where a search begins that goes on from a former fit."""
    signal = hyper_parameters.signal_std
    ratios = [hyper_parameters.noise_std / signal]
    bounds = [NOISE_RATIO_BOUNDS]
    if basis == "linear":
        ratios.append(hyper_parameters.slope_std / signal)
        bounds.append(SLOPE_RATIO_BOUNDS)
    return np.log(
        [*hyper_parameters.length_scale, *(np.clip(ratio, *bound) for ratio, bound in zip(ratios, bounds, strict=True))]
    )


def _prior_median(inputs: int, parameters: int) -> Array:
    """Of the log parameters; shape (parameters,)."""
    return np.log([*[PRIOR_LENGTH_SCALE] * inputs, PRIOR_NOISE_RATIO, PRIOR_SLOPE_RATIO][:parameters])


def _search(evidence: Evidence, cold: Sequence[Array], warm: Sequence[Array] = ()) -> Array:
    """Log parameters of the least loss that is reached from `cold` and `warm` starts."""
    with _blas().limit(limits=1, user_api="blas"):  # more threads only wait for each other at these sizes
        starts = [*warm, *cold]
        if len(starts) > 1 and len(evidence.values) > COLD_START_SIZE:
            some = np.linspace(0, len(evidence.values) - 1, COLD_START_SIZE).astype(int)
            part = replace(evidence, points=evidence.points[some], values=evidence.values[some])
            contenders = [*warm, _descend(part, cold, tolerance=1e-6)]
            starts = [min(contenders, key=lambda start: evidence.loss(start)[0])]
        return _descend(evidence, starts, tolerance=1e-8)


def _descend(evidence: Evidence, starts: Sequence[Array], tolerance: float) -> Array:
    """The best end of searches from `starts`, each of which stops once the loss falls by less than this share of it."""
    bounds = [LENGTH_SCALE_BOUNDS] * evidence.length_scales + [NOISE_RATIO_BOUNDS, SLOPE_RATIO_BOUNDS]
    if evidence.last_length_scale is not None:
        bounds[evidence.length_scales - 1] = (evidence.last_length_scale, evidence.last_length_scale)
    log_bounds = np.log(bounds[: len(starts[0])])
    options = {"maxiter": 200, "ftol": tolerance, "gtol": 1e-3}
    ends = [
        minimize(evidence.loss, begin, jac=True, method="L-BFGS-B", bounds=log_bounds, options=options)
        for begin in np.clip(starts, *log_bounds.T)
    ]
    return min(ends, key=lambda end: end.fun).x


@cache
def _blas() -> ThreadpoolController:
    """The threads of linear algebra; to find them takes longer than a fit to some dozens of points."""
    return ThreadpoolController()
