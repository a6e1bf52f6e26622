"""Possible causes of the error of a run, errors as polynomials, and sizes of causes by Bayesian linear regression."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf, isinf, sqrt
from typing import Final, NamedTuple, final

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from stepgap.gauss.monomials import monomials
from stepgap.learning.observations import Observations
from stepgap.learning.polynomial import PRIOR_STD, fit_polynomial
from stepgap.learning.regression import TrainingData
from stepgap.robots.gap import Gap, differences
from stepgap.step import Array

SIGNATURE_DEGREE: Final = 2
"""Degree of the polynomials."""

RESTS: Final = np.array([0.0, *np.geomspace(1e-3, 0.3, 9)])
"""Standard deviations of the weights of the rest, of which each is as probable as the others [half ranges]."""

MOST_INACCURACY: Final = 0.6
"""Largest share of the square of a signature, or of a sum of signatures, that is ascribed to its inaccuracy."""

IMPROBABLE: Final = 3.6
"""Error of the polynomial, in standard deviations, from which on a step counts as disturbed."""

LEAST_STD: Final = 0.02
"""The polynomial is not taken to be more accurate than this [half ranges]."""

LARGEST_SHARE: Final = 12.0
"""Largest size of a cause, in usual sizes."""

Shares = Mapping[str, float]
"""Sizes of causes, in usual sizes, by their names."""


class Cause(NamedTuple):
    """A difference of a simulated robot from its model.

    Attributes:
        name: Its name in the gap.
        exact: Its value without gap.
        usual: A usual value.
        least: Smallest size that is valid [usual sizes]; negative where values on the other side of `exact` are valid.
        most: Largest size that is valid.
    """

    name: str
    exact: float
    usual: float
    least: float = 0.0
    most: float = LARGEST_SHARE

    @property
    def signed(self) -> bool:
        """Whether values on the other side of `exact` are valid."""
        return self.least < 0

    def value(self, share: float) -> float:
        """The value of a size; a stiffness that is infinite without gap is divided by the size."""
        if isinf(self.exact):
            return self.usual / share if share > 0 else inf
        return self.exact + share * (self.usual - self.exact)


def causes_of(gap: Gap) -> tuple[Cause, ...]:
    """The differences of a gap that may be causes: numbers with a usual value."""
    none, found = type(gap).none(), list[Cause]()
    for name, known in differences(gap).items():
        if known.exact is None or isinstance(known.exact, bool) or known.whole == known.exact:
            continue
        cause = Cause(name, known.exact, known.whole)

        def is_valid(share: float, cause: Cause = cause) -> bool:
            try:
                type(gap)(**{**vars(none), cause.name: cause.value(share)})
            except ValueError:
                return False
            return True

        least = 0.0 if isinf(cause.exact) else _furthest(is_valid, -LARGEST_SHARE)
        found.append(cause._replace(least=least, most=_furthest(is_valid, LARGEST_SHARE)))
    return tuple(found)


def _furthest(is_valid: Callable[[float], bool], end: float) -> float:
    """The size nearest to `end` that is valid, by bisection from 0, which is."""
    near, far = 0.0, end
    if is_valid(end):
        return end
    for _ in range(12):
        middle = (near + far) / 2
        near, far = (middle, far) if is_valid(middle) else (near, middle)
    return near


class Surface(NamedTuple):
    """The error of a nominal map as polynomials of the scaled state and command.

    Attributes:
        weights: Weights of the k monomials for each state coordinate; shape (n, k) [half ranges].
        covariance: Their covariances; shape (n, k, k).
    """

    weights: Array
    covariance: Array


def fit_surface(steps: Observations) -> tuple[Surface, Array]:
    """Fits the error of some steps; also returns the standard deviations of the steps about it (n,) [half ranges].

    As many degrees of freedom are taken off as weights are determined, since each takes one from the noise.
    """
    points = steps.space.scaled_inputs(steps.state, steps.command)
    centre, scale = np.zeros(points.shape[1]), np.ones(points.shape[1])
    fits = [
        fit_polynomial(TrainingData(points, values, centre, scale, 1.0), SIGNATURE_DEGREE)
        for values in (steps.error / steps.space.state_scale).T
    ]
    first, degrees = fits[0], fits[0].moments.degrees_of_freedom  # the same for all coordinates
    determined = len(first.weights) - float(np.trace(first.weight_covariance)) / (first.noise_std * PRIOR_STD) ** 2
    factor = (degrees - 2) / (degrees - determined)
    covariance = factor * np.array([each.weight_covariance for each in fits])
    return Surface(np.array([each.weights for each in fits]), covariance), np.array(
        [sqrt(factor) * each.noise_std for each in fits]
    )


@final
@dataclass(frozen=True, eq=False)
class RunError:
    """The errors of a run, reduced to r ≤ k numbers for each state coordinate, with independent noise of variance 1.

    Attributes:
        values: Shape (n, r).
        roots: Matrices that convert weights to such numbers; shape (n, r, k).
        noise_std: Standard deviation of the noise of a step; shape (n,) [half ranges].
        steps: Number of steps.
    """

    values: Array
    roots: Array
    noise_std: Array
    steps: int

    @classmethod
    def of(cls, steps: Observations) -> "RunError":
        """Reduces the errors of these steps, without those that are too improbable for the polynomial."""
        surface, noise_std = fit_surface(steps)
        left = steps.error / steps.space.state_scale - (
            monomials(steps.space.scaled_inputs(steps.state, steps.command), SIGNATURE_DEGREE) @ surface.weights.T
        )
        steps = steps.selected(np.all(np.abs(left) <= IMPROBABLE * np.maximum(noise_std, LEAST_STD), axis=1))
        _, noise_std = fit_surface(steps)
        basis = monomials(steps.space.scaled_inputs(steps.state, steps.command), SIGNATURE_DEGREE)
        q, r = np.linalg.qr(basis)
        values = q.T @ (steps.error / steps.space.state_scale / noise_std)
        return cls(values.T, r / noise_std[:, None, None], noise_std, len(steps))

    def seen(self, weights: Array) -> Array:
        """The numbers of weights (n, k); shape (n, r)."""
        return np.einsum("nrk,nk->nr", self.roots, weights)

    def effect(self, weights: Array) -> float:
        """Sum of squares of the numbers of weights (n, k)."""
        return float(np.sum(self.seen(weights) ** 2))

    def spread(self, covariance: Array) -> float:
        """Expected `effect` of weights of these covariances (n, k, k) about zero."""
        return float(np.einsum("nrk,nkl,nrl->", self.roots, covariance, self.roots))

    def squares(self, weights: Array) -> Array:
        """Sums of squares of what weights (n, k) leave, less what noise makes of them; shape (n,)."""
        return np.sum((self.values - self.seen(weights)) ** 2, axis=1) - self.values.shape[1]


class SizeFit(NamedTuple):
    """Sizes of p causes.

    Attributes:
        log_evidence: Logarithm of the probability density of the errors.
        sizes: Expected sizes; shape (p,).
        covariance: Shape (p, p).
    """

    log_evidence: float
    sizes: Array
    covariance: Array


def fit_sizes(
    error: RunError, origin: Surface, sizes: Array, slopes: Array, inaccuracy: Array, rests: Array = RESTS
) -> SizeFit:
    """Sizes of causes about a simulated robot, by Bayesian linear regression averaged over the size of the rest.

    A priori the effect of each cause may be as large as the whole error of the run. Slopes are inaccurate, which would
    make them longer, and sizes smaller, than they are; so what inaccuracy adds to their squares is taken off (errors
    in variables, Fuller, Measurement Error Models, Sec. 2.2). The covariance has what it adds to the errors.

    Args:
        error: Errors of the run.
        origin: Error of the robot that was simulated with some sizes.
        sizes: These sizes; shape (p,).
        slopes: Change of the error by a change of each size; shape (p, n, k).
        inaccuracy: Their covariances, in covariances of `origin`; shape (p,).
        rests: Possible standard deviations of the weights of the rest.
    """
    left = error.values - error.seen(origin.weights)
    h = np.array([error.seen(slope) for slope in slopes]).reshape(len(slopes), *left.shape)
    whole = max(float(np.sum(error.values**2)), 1.0)
    prior = np.maximum(np.sum(h**2, axis=(1, 2)), 1e-12) / whole
    found = list[SizeFit]()
    for rest in rests:
        information, projection, log = np.diag(prior), -prior * sizes, 0.5 * float(np.sum(np.log(prior)))
        log -= 0.5 * float(sizes @ (prior * sizes))
        length, scatter = 0.0, np.zeros_like(information)
        for root, spread, value, columns in zip(error.roots, origin.covariance, left, h.swapaxes(0, 1), strict=True):
            simulated = root @ spread @ root.T
            total = np.eye(len(value)) + simulated + rest**2 * root @ root.T
            factor = cho_factor(total, lower=True)
            solved = cho_solve(factor, np.column_stack([value, columns.T, simulated]))
            length += float(np.trace(solved[:, 1 + len(sizes) :]))
            log -= 0.5 * float(value @ solved[:, 0]) + float(np.sum(np.log(np.diag(factor[0]))))
            known = solved[:, 1 : 1 + len(sizes)]
            information, scatter = information + columns @ known, scatter + known.T @ simulated @ known
            projection = projection + columns @ solved[:, 0]
        log += 0.5 * float(projection @ np.linalg.solve(information, projection))
        log -= 0.5 * float(np.linalg.slogdet(information)[1])
        added = length * np.diag(inaccuracy)
        largest = max(np.linalg.eigvals(np.linalg.solve(information, added)).real, default=0.0)
        inverse = np.linalg.inv(information - added * min(1.0, MOST_INACCURACY / max(largest, 1e-12)))
        change = inverse @ projection
        covariance = inverse @ (information + float(change**2 @ inaccuracy) * scatter) @ inverse
        found.append(SizeFit(log, sizes + change, covariance))
    logs = np.array([each.log_evidence for each in found])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    mean = sum((w * each.sizes for w, each in zip(weights, found, strict=True)), np.zeros(len(sizes)))
    spread = [
        w * (each.covariance + np.outer(each.sizes - mean, each.sizes - mean))
        for w, each in zip(weights, found, strict=True)
    ]
    evidence = float(logs.max() + np.log(np.mean(np.exp(logs - logs.max()))))
    return SizeFit(evidence, mean, np.sum(spread, axis=0))
