"""What the hyper-parameters of a Gaussian process maximise, given data: a likelihood or a posterior, with its gradient.

Equations marked RW are those of Rasmussen and Williams, Gaussian Processes for Machine Learning (2006).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
from scipy.spatial.distance import pdist
from scipy.special import wrightomega

from stepgap.gauss.covariance import covariance_matrix, evidence_gradient
from stepgap.gauss.gaussian_process import HyperParameters
from stepgap.gauss.kernel import MATERN_52, Kernel
from stepgap.gauss.least_squares import LeastSquares, factorise, fit_least_squares, inverse_triangle, solve_transposed
from stepgap.step import Array

PRIOR_LENGTH_SCALE = 3.0
PRIOR_NOISE_RATIO = 0.5
PRIOR_SLOPE_RATIO = 1.0
"""Medians of the priors, in input scales and signals."""

PRIOR_SIGNAL = 0.25  # Median of the prior of the signal, in value scales


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


class LogPrior(NamedTuple):
    """Log density of the priors up to a constant, and its derivatives.

    Attributes:
        value: The log density.
        gradient: With respect to the `LogParameters`, at a fixed signal; shape (P,).
        by_log_signal: With respect to log(signal_std).
    """

    value: float
    gradient: Array
    by_log_signal: float


@final
@dataclass(frozen=True, eq=False)
class Evidence:
    """How well hyper-parameters explain data: by their likelihood, or by their posterior under weak priors.

    The signal is not among the `LogParameters`: for given ones the best signal has a closed form.

    Attributes:
        points: In input scales; shape (N, d).
        values: Shape (N,).
        value_scale: Scale of the signal's prior, with which β is integrated out (RW Eq. 2.45). None: no priors, and
            the most likely β (RW Eq. 2.30).
        length_scales: Number of length scales: d, or 1 if it is common to all inputs.
        least_noise: Lower bound of the noise's standard deviation.
        last_length_scale: Length scale of the last input, where it is not searched.
        kernel: Covariance of f.
    """

    points: Array
    values: Array
    value_scale: float | None
    length_scales: int
    least_noise: float
    last_length_scale: float | None = None
    kernel: Kernel = MATERN_52

    def loss(self, parameters: LogParameters) -> tuple[float, LogParameters]:
        """Negative logarithm of what is maximised, and its gradient (RW Eqs. 5.8, 5.9)."""
        squared, linear_features, solved, signal = self._solve(parameters)
        # K is in units of signal². The signal is the best one for these parameters, where the loss does not
        # change with it to first order, so its gradient is that at a fixed signal, but for the exception below.
        log_density, alpha = self._log_density(solved, signal)
        K_inv = inverse_triangle(solved.factor)
        dk_dr = self.kernel.radial_derivative(squared)
        by_length_scale, by_slope, by_noise = evidence_gradient(K_inv, alpha, dk_dr, self.points, linear_features)
        by_ratio = float(np.exp(2 * parameters.noise_ratio)) * by_noise
        # This part is zero except where the noise is at its lower bound: there the signal follows from the ratio.
        prior = self._log_prior(parameters, signal)
        by_ratio += self.degrees_of_freedom - solved.quadratic_form / signal**2
        by_ratio -= prior.by_log_signal
        gradient = LogParameters(
            np.exp(-2 * parameters.length_scale) * by_length_scale.reshape(self.length_scales, -1).sum(axis=1),
            by_ratio,
            None if parameters.slope_ratio is None else by_slope,
        )
        loss = -log_density - prior.value
        return loss, gradient.with_vector(-gradient.vector - prior.gradient)

    def hyper_parameters(self, parameters: LogParameters) -> HyperParameters:
        """Converts the parameters to hyper-parameters, with the best signal."""
        _, _, _, signal = self._solve(parameters)
        ratio, slope = parameters.ratios
        length_scale = np.broadcast_to(np.exp(parameters.length_scale), self.points.shape[1:]).copy()
        return HyperParameters(length_scale, signal, signal * ratio, signal * slope)

    def _solve(self, parameters: LogParameters) -> tuple[Array, Array, LeastSquares, float]:
        """r² of every pair of points, linear features, least squares, and the best signal_std."""
        ratio, slope = parameters.ratios
        squared = np.asarray(pdist(self.points * np.exp(-parameters.length_scale), "sqeuclidean"), float)
        linear_features = (self.points - self.points[0]) * slope
        matrix = covariance_matrix(self.kernel.covariance(squared), linear_features, ratio**2)
        solved = fit_least_squares(factorise(matrix), self.values)
        signal = self.best_signal(solved.quadratic_form)
        return squared, linear_features, solved, max(signal, self.least_noise / ratio)

    @property
    def degrees_of_freedom(self) -> int:
        """Degrees of freedom that the values leave to the signal; one less where β is integrated out."""
        return len(self.values) if self.value_scale is None else len(self.values) - 1

    def best_signal(self, quadratic_form: float) -> float:
        """Most probable signal_std s, for the quadratic form of `LeastSquares`.

        With log s ~ N(log m, 1) it is the root of quadratic_form/s² = degrees of freedom + log(s/m).
        """
        if self.value_scale is None:
            return math.sqrt(quadratic_form / self.degrees_of_freedom)
        median = PRIOR_SIGNAL * self.value_scale
        twice = 2.0 * self.degrees_of_freedom
        omega = float(wrightomega(np.log(2 * quadratic_form / median**2) + twice)) if quadratic_form > 0 else 0.0
        return median * math.exp(0.5 * (omega - twice))

    def _log_density(self, solved: LeastSquares, signal: float) -> tuple[float, Array]:
        """Log density of the values, and the columns `alpha` (N, 2) by which `evidence_gradient` gives its gradient."""
        weights = solved.weights / signal
        if self.value_scale is None:
            return solved.log_likelihood(signal), np.stack([weights, np.zeros(len(weights))], axis=1)
        K_inv_1 = solve_transposed(solved.factor, solved.basis)
        return solved.log_evidence(signal), np.stack([weights, K_inv_1 / math.sqrt(K_inv_1.sum())], axis=1)

    def _log_prior(self, parameters: LogParameters, signal: float) -> LogPrior:
        """Log density of independent normal distributions of all logarithms, each with the standard deviation 1."""
        if self.value_scale is None:
            return LogPrior(0.0, np.zeros(len(parameters.vector)), 0.0)
        length_scales = [PRIOR_LENGTH_SCALE] * len(parameters.length_scale)
        medians = [*length_scales, PRIOR_NOISE_RATIO, PRIOR_SLOPE_RATIO][: len(parameters.vector)]
        deviation = parameters.vector - np.log(medians)
        of_signal = math.log(signal / (PRIOR_SIGNAL * self.value_scale))
        return LogPrior(-0.5 * float(deviation @ deviation) - 0.5 * of_signal**2, -deviation, -of_signal)
