"""Hyper-parameters of a Gaussian process from data: the most probable ones, or those of MATLAB's `fitrgp`.

Equations marked RW are those of Rasmussen and Williams, Gaussian Processes for Machine Learning (2006).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, TypedDict, final

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import get_lapack_funcs
from scipy.optimize import minimize
from scipy.spatial.distance import pdist
from scipy.special import wrightomega

from stepgap.base.blas import one_blas_thread
from stepgap.base.ranges import require
from stepgap.learning.cholesky import factorise
from stepgap.learning.covariance import covariance_matrix, evidence_gradient
from stepgap.learning.exact_gaussian_process import ExactGaussianProcess, condition
from stepgap.learning.gaussian_process import HyperParameters, checked_data
from stepgap.learning.kernel import MATERN_52, Kernel
from stepgap.learning.least_squares import LeastSquares, fit_least_squares
from stepgap.step import Array

Basis = Literal["constant", "linear"]
"""Basis of a Gaussian process besides f and noise: a constant, or a constant and slopes."""


class Search(TypedDict, total=False):
    """Options of a search for hyper-parameters; see `fit_gaussian_process`."""

    basis: Basis
    kernel: Kernel
    start: HyperParameters | None
    last_length_scale: float | None


COLD_START_SIZE = 100
"""Number of points above which the cold starts search on a part of the points; only the best uses all of them."""

LENGTH_SCALE_BOUNDS = (1e-2, 1e3)
"""Search range in input scales; for `fit_like_fitrgp` in units of its initial value."""

NOISE_RATIO_BOUNDS = (1e-4, 1e2)
"""Search range of noise over signal; its lower end keeps duplicated points well conditioned."""

SLOPE_RATIO_BOUNDS = (1e-3, 1e2)
"""Search range of the slopes' standard deviation over the signal's; at its lower end slopes are negligible."""

PRIOR_LENGTH_SCALE, PRIOR_NOISE_RATIO, PRIOR_SLOPE_RATIO = 3.0, 0.5, 1.0
"""Medians of the priors, in input scales and signals."""

PRIOR_SIGNAL = 0.25
"""Median of the prior of the signal, in value scales."""

LEAST_NOISE = 1e-3
"""Least standard deviation of the noise, in value scales; it is negligible in practice."""

(_potri,) = get_lapack_funcs(("potri",), dtype=np.float64)


def fit_gaussian_process(
    points: ArrayLike,
    values: ArrayLike,
    input_scale: ArrayLike,
    value_scale: float | None = None,
    *,
    basis: Basis = "constant",
    kernel: Kernel = MATERN_52,
    start: HyperParameters | None = None,
    last_length_scale: float | None = None,
) -> ExactGaussianProcess:
    """Fits a Gaussian process: the most probable hyper-parameters under weak priors, one length scale per input.

    A priori log(length scale) ~ N(log 3, 1) for each input, log(noise/signal) ~ N(log 0.5, 1), log(signal) ~
    N(log(value_scale/4), 1) and, with the linear basis, log(slopes/signal) ~ N(0, 1), while β is flat and
    integrated out. Without these priors a fit to fewer than 50 points often mistakes noise for signal, and a fit to a
    single point, or to equal values, would have far too small standard deviations. The noise is at least
    0.001 value_scale. The search is deterministic: the same data give the same process.

    Args:
        points: Shape (N, d), N ≥ 1.
        values: Shape (N,).
        input_scale: Fixed size of each input, not taken from the data; shape (d,).
        value_scale: Fixed size of the values, such as half the range of use of the quantity they are errors of. By
            default half the range of the values: then equal values give tiny standard deviations.
        basis: Constant, or constant and slopes whose size is fitted.
        kernel: Covariance of f.
        start: Hyper-parameters of an earlier fit: the search then starts there and at a single cold start.
        last_length_scale: Length scale of the last input, where it is fixed and not searched.

    Raises:
        ValueError: Data or scales are not finite, or their sizes do not fit.
    """
    points, values, input_scale = checked_data(points, values, input_scale)
    if value_scale is None:
        value_scale = max(0.5 * float(np.ptp(values)), 1e-6 * float(np.abs(values).max()), 1e-12)
    require(0 < value_scale < math.inf, "value_scale", value_scale, "be positive and finite")
    least_noise = LEAST_NOISE * value_scale
    evidence = Evidence(
        points / input_scale, values, points.shape[1], least_noise, value_scale, last_length_scale, kernel
    )
    cold = cold_starts(points.shape[1], basis)
    if start is None:
        log_parameters = _search(evidence, cold)
    else:
        log_parameters = _search(evidence, cold[:1], [_log_parameters(start, basis)])
    found, fitted = evidence.hyper_parameters(log_parameters), len(log_parameters.vector) + 1
    return condition(points, values, input_scale, _widened(found, len(values), fitted), kernel)


def _widened(found: HyperParameters, size: int, fitted: int) -> HyperParameters:
    """Multiplies all variances by (N + 3p)/(N + p), for p fitted parameters; the mean does not change.

    The variance at the most probable parameters is too small, as is that of the residuals of a least-squares fit. There
    the variance is divided by N − p and intervals are those of Student's t: together a factor of some 1 + 2p/N. Here
    each prior counts like one more value. Without this factor, 95 % intervals contained 91 or 92 % of new values at
    N = 30.
    """
    wider = math.sqrt((size + 3 * fitted) / (size + fitted))
    stds = (wider * std for std in (found.signal_std, found.noise_std, found.slope_std))
    return HyperParameters(found.length_scale, *stds)


def fit_like_fitrgp(points: ArrayLike, values: ArrayLike) -> ExactGaussianProcess:
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
    spread, values_spread = (points.std(axis=0, ddof=1).mean(), values.std(ddof=1)) if len(values) > 1 else (0.0, 0.0)
    initial = spread if spread > 0 else 1.0
    least_noise = max(1e-6 * float(np.abs(values).max()), 1e-12, 0.01 * values_spread)
    evidence = Evidence(points / initial, values, 1, least_noise, None)
    found = evidence.hyper_parameters(_search(evidence, [LogParameters(np.zeros(1), 0.0)]))
    hyper_parameters = HyperParameters(initial * found.length_scale, found.signal_std, found.noise_std)
    return condition(points, values, raw_units, hyper_parameters)


class LogParameters(NamedTuple):
    """Logarithms of the hyper-parameters that are searched, or a gradient with respect to them.

    Attributes:
        length_scale: Log length scales: d, or a common one for all inputs.
        noise_ratio: Log of the noise's standard deviation over the signal's.
        slope_ratio: Log of the slopes' standard deviation over the signal's. None: there are no slopes.
    """

    length_scale: Array
    noise_ratio: float
    slope_ratio: float | None = None

    @property
    def vector(self) -> Array:
        """All parameters as one vector, for an optimiser; shape (P,)."""
        ratios = [self.noise_ratio] if self.slope_ratio is None else [self.noise_ratio, self.slope_ratio]
        return np.concatenate([self.length_scale, ratios])

    @property
    def ratios(self) -> tuple[float, float]:
        """Noise and slopes over the signal; the latter is zero without slopes."""
        noise = float(np.exp(self.noise_ratio))
        return noise, 0.0 if self.slope_ratio is None else float(np.exp(self.slope_ratio))

    def with_vector(self, vector: Array) -> "LogParameters":
        """Returns the same parameters with other values (P,)."""
        length_scale, ratios = np.split(vector, [len(self.length_scale)])
        return LogParameters(length_scale, *ratios.tolist())


@final
@dataclass(frozen=True, eq=False)
class Evidence:
    """Log posterior of the hyper-parameters given the data.

    The signal is not among the `LogParameters`: for given ones the most probable signal has a closed form.

    Attributes:
        points: In input scales; shape (N, d).
        values: Shape (N,).
        length_scales: Number of length scales: d, or 1 if it is common to all inputs.
        least_noise: Lower bound of the noise's standard deviation.
        value_scale: Scale of the signal's prior. None: no priors, and β not integrated out: maximum likelihood.
        last_length_scale: Length scale of the last input, where it is not searched.
        kernel: Covariance of f.
    """

    points: Array
    values: Array
    length_scales: int
    least_noise: float
    value_scale: float | None
    last_length_scale: float | None = None
    kernel: Kernel = MATERN_52

    def loss(self, parameters: LogParameters) -> tuple[float, LogParameters]:
        """Negative log posterior and its gradient (RW Eqs. 2.45, 5.8, 5.9)."""
        squared, linear_features, solved, signal = self._solve(parameters)
        alpha = np.zeros((len(self.values), 2))
        alpha[:, 0] = solved.weights / signal
        log_posterior = solved.log_likelihood(signal)
        if self.value_scale is not None:
            K_inv_1 = solved.factor.solve_transposed(solved.basis)
            alpha[:, 1] = K_inv_1 / math.sqrt(K_inv_1.sum())
            log_posterior = solved.log_evidence(signal)
        K_inv, _ = _potri(solved.factor.base, lower=1)
        # potri fills the lower triangle in Fortran order: the upper one in C order.
        dk_dr = self.kernel.radial_derivative(squared)
        by_length_scale, by_slope, by_noise = evidence_gradient(K_inv.T, alpha, dk_dr, self.points, linear_features)
        by_ratio = float(np.exp(2 * parameters.noise_ratio)) * by_noise
        # This part is zero except where the noise is at its lower bound: there the signal follows from the ratio.
        by_ratio += self._degrees_of_freedom - solved.quadratic_form / signal**2
        if self.value_scale is not None:
            by_ratio += self._signal_deviation(signal)
        gradient = LogParameters(
            np.exp(-2 * parameters.length_scale) * by_length_scale.reshape(self.length_scales, -1).sum(axis=1),
            by_ratio,
            None if parameters.slope_ratio is None else by_slope,
        )
        log_prior, prior_gradient = self._log_prior(parameters, signal)
        return -log_posterior - log_prior, gradient.with_vector(-gradient.vector - prior_gradient)

    def hyper_parameters(self, parameters: LogParameters) -> HyperParameters:
        """Converts the parameters to hyper-parameters, with the most probable signal."""
        _, _, _, signal = self._solve(parameters)
        ratio, slope = parameters.ratios
        length_scale = np.broadcast_to(np.exp(parameters.length_scale), self.points.shape[1:]).copy()
        return HyperParameters(length_scale, signal, signal * ratio, signal * slope)

    def signal(self, quadratic_form: float) -> float:
        """Most probable signal_std s.

        With log s ~ N(log m, 1) it is the root of quadratic_form/s² = degrees of freedom + log(s/m).
        """
        if self.value_scale is None:
            return math.sqrt(quadratic_form / self._degrees_of_freedom)
        median, twice = PRIOR_SIGNAL * self.value_scale, 2.0 * self._degrees_of_freedom
        omega = float(wrightomega(np.log(2 * quadratic_form / median**2) + twice)) if quadratic_form > 0 else 0.0
        return median * math.exp(0.5 * (omega - twice))

    @property
    def _degrees_of_freedom(self) -> int:
        """Degrees of freedom of the signal: the number of values, less one for β where it is integrated out."""
        return len(self.values) - (self.value_scale is not None)

    def _signal_deviation(self, signal: float) -> float:
        """Deviation of log(signal) from the median of its prior."""
        assert self.value_scale is not None
        return math.log(signal / (PRIOR_SIGNAL * self.value_scale))

    def _log_prior(self, parameters: LogParameters, signal: float) -> tuple[float, Array]:
        """Log density of the priors up to a constant, and its gradient at a fixed signal (P,)."""
        if self.value_scale is None:
            return 0.0, np.zeros(len(parameters.vector))
        deviation = parameters.vector - _prior_median(parameters)
        return -0.5 * float(deviation @ deviation) - 0.5 * self._signal_deviation(signal) ** 2, -deviation

    def _solve(self, parameters: LogParameters) -> tuple[Array, Array, LeastSquares, float]:
        """r² of every pair of points, linear features, least squares, and the most probable signal_std."""
        ratio, slope = parameters.ratios
        squared = np.asarray(pdist(self.points * np.exp(-parameters.length_scale), "sqeuclidean"), float)
        linear_features = (self.points - self.points[0]) * slope
        matrix = covariance_matrix(self.kernel.covariance(squared), linear_features, ratio**2)
        solved = fit_least_squares(factorise(matrix), self.values)
        return squared, linear_features, solved, max(self.signal(solved.quadratic_form), self.least_noise / ratio)


def cold_starts(inputs: int, basis: Basis = "constant") -> list[LogParameters]:
    """Log parameters at which a search starts: all inputs equally relevant, then each input alone relevant.

    The first start alone ends up to 110 nats below the best if only one input is relevant and N ≤ 50.
    """
    length_scales = np.vstack([np.ones(inputs), np.where(np.eye(inputs) == 1, 0.5, 5.0)])
    noise_ratio, slope_ratio = np.log([0.2, 0.5]).tolist()
    slopes = (slope_ratio,) if basis == "linear" else ()
    return [LogParameters(np.log(start), noise_ratio, *slopes) for start in length_scales]


def _log_parameters(hyper_parameters: HyperParameters, basis: Basis) -> LogParameters:
    """Log parameters of an earlier fit, as the start of a search."""
    signal = hyper_parameters.signal_std
    ratios = [np.clip(hyper_parameters.noise_std / signal, *NOISE_RATIO_BOUNDS)]
    if basis == "linear":
        ratios.append(np.clip(hyper_parameters.slope_std / signal, *SLOPE_RATIO_BOUNDS))
    return LogParameters(np.log(hyper_parameters.length_scale), *np.log(ratios).tolist())


def _prior_median(parameters: LogParameters) -> Array:
    """Prior medians of the log parameters; shape (P,)."""
    length_scales = [PRIOR_LENGTH_SCALE] * len(parameters.length_scale)
    return np.log([*length_scales, PRIOR_NOISE_RATIO, PRIOR_SLOPE_RATIO][: len(parameters.vector)])


def _search(evidence: Evidence, cold: Sequence[LogParameters], warm: Sequence[LogParameters] = ()) -> LogParameters:
    """Searches the log parameters of least loss from `cold` and `warm` starts."""
    with one_blas_thread():
        starts = [*warm, *cold]
        if len(starts) > 1 and len(evidence.values) > COLD_START_SIZE:
            some = np.linspace(0, len(evidence.values) - 1, COLD_START_SIZE).astype(int)
            part = replace(evidence, points=evidence.points[some], values=evidence.values[some])
            contenders = [*warm, _descend(part, cold, tolerance=1e-6)]
            starts = [min(contenders, key=lambda start: evidence.loss(start)[0])]
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
