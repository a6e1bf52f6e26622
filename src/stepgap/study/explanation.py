"""What the error of a run says about the robot: sizes of its possible differences from the model, by one regression.

The error of the nominal map, over state and command, is a quadratic polynomial for each state coordinate. The
*signature* of a cause is how the polynomial of a simulated robot changes when that one difference is set, per size. The
sizes of all causes follow from the error of the run by Bayesian linear regression:

    error of the run − error of the simulated robot without gap = signatures · sizes + rest + noise

Sizes are normal about zero. The rest is what no cause explains: a polynomial whose weights have a common variance, the
most probable one (marginal likelihood; MacKay, Information Theory, Inference, and Learning Algorithms, Ch. 28). Where
signatures are alike over the steps of the run, the sizes of all causes together are uncertain, although each alone
would have a certain size; so both are given.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isinf
from typing import Final, NamedTuple, final

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from stepgap.base.errors import InputError
from stepgap.base.normal import INTERVAL_95, log_density
from stepgap.gauss.monomials import monomials
from stepgap.gauss.weights import Weights
from stepgap.learning.observations import Observations
from stepgap.robots.gap import Gap, differences
from stepgap.step import Array

SIGNATURE_DEGREE: Final = 2  # Degree of the polynomials

LARGEST_WEIGHT: Final = 30.0
"""Prior standard deviation of a polynomial's weight, in standard deviations of the steps about it."""

USUAL_STD: Final = 0.02
"""Standard deviation of the steps about their polynomial beforehand [half ranges], which counts as much as three steps;
polynomials are not taken to be more accurate when disturbed steps are left out."""

IMPROBABLE: Final = 3.6
"""Error of the polynomial, in standard deviations, from which on a step counts as disturbed."""

RESTS: Final = (0.0, *np.geomspace(1e-3, 0.3, 9).tolist())
"""Possible standard deviations of the weights of the rest [half ranges]."""

PRIOR_SIZE: Final = 3.0  # Standard deviation of the size of a cause beforehand [usual sizes]
LARGEST_SHARE: Final = 12.0  # Largest size of a cause, in usual sizes
LARGEST_SIMULATED: Final = 4.0  # Largest size at which a cause is simulated [usual sizes]

SMALLEST_SIMULATED: Final = 0.2
"""Smallest such size; of a smaller one, the effect may be less than the scatter of the simulation."""

ALIKE: Final = 0.9
"""Cosine of signatures from which on causes cannot be told apart: signatures are inaccurate by some percent."""

UNSEEN_STD: Final = 0.5
"""Standard deviation of the size of a cause alone from which on the run says nothing of it [usual sizes]."""

REST_LOG_ODDS: Final = 3.0  # Logarithm of the odds from which on it is said that there is a rest

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
        """The value of a size or the valid one next to it; an infinite stiffness becomes the usual one by the size."""
        share = min(max(share, self.least), self.most)
        if isinf(self.exact):
            return self.usual / share if share > 0 else inf
        return self.exact + share * (self.usual - self.exact)


def causes_of(gap: Gap) -> tuple[Cause, ...]:
    """The differences of a gap that may be causes: numbers with a usual value."""
    none = type(gap).none()
    causes = list[Cause]()
    for name, rule in differences(gap).items():
        if rule.exact is None or isinstance(rule.exact, bool) or rule.whole == rule.exact:
            continue
        cause = Cause(name, rule.exact, rule.whole, -LARGEST_SHARE)

        def is_valid(share: float, cause: Cause = cause) -> bool:
            try:
                type(gap)(**{**vars(none), cause.name: cause.value(share)})
            except ValueError:
                return False
            return True

        least = 0.0 if isinf(cause.exact) else _furthest(is_valid, -LARGEST_SHARE)
        causes.append(cause._replace(least=least, most=_furthest(is_valid, LARGEST_SHARE)))
    return tuple(causes)


def _furthest(is_valid: Callable[[float], bool], end: float) -> float:
    """The size nearest to `end` that is valid, by bisection from 0, which is."""
    if is_valid(end):
        return end
    near = 0.0
    far = end
    for _ in range(12):
        middle = (near + far) / 2
        if is_valid(middle):
            near = middle
        else:
            far = middle
    return near


class Surface(NamedTuple):
    """The error of a nominal map as polynomials of the scaled state and command.

    Attributes:
        weights: Weights of the k monomials for each state coordinate; shape (n, k) [half ranges].
        covariance: Their covariances; shape (n, k, k).
        noise_std: Standard deviations of the steps about the polynomials; shape (n,) [half ranges].
    """

    weights: Array
    covariance: Array
    noise_std: Array


def fit_surface(steps: Observations) -> Surface:
    """Fits the error of some steps by least squares; weights that the steps do not determine are nearly zero."""
    basis = _basis(steps)
    errors = steps.error / steps.space.state_scale
    # A = BᵀB + I / LARGEST_WEIGHT², weights = A⁻¹Bᵀ errors, covariance = noise² A⁻¹
    inverse = np.linalg.inv(basis.T @ basis + np.eye(basis.shape[1]) / LARGEST_WEIGHT**2)
    weights = inverse @ basis.T @ errors
    # As many degrees of freedom are taken off as weights are determined, since each takes one from the noise.
    determined = float(np.trace(inverse @ basis.T @ basis))
    squares = np.sum((errors - basis @ weights) ** 2, axis=0)
    variance = (squares + 3 * USUAL_STD**2) / (len(errors) - determined + 3)
    return Surface(weights.T, variance[:, None, None] * inverse, np.sqrt(variance))


def _basis(steps: Observations) -> Array:
    return monomials(steps.space.scaled_inputs(steps.state, steps.command), SIGNATURE_DEGREE)


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
        surface = fit_surface(steps)
        left = steps.error / steps.space.state_scale - _basis(steps) @ surface.weights.T
        limit = IMPROBABLE * np.maximum(surface.noise_std, USUAL_STD)
        steps = steps.selected(np.all(np.abs(left) <= limit, axis=1))
        noise_std = fit_surface(steps).noise_std
        q, r = np.linalg.qr(_basis(steps))
        values = q.T @ (steps.error / steps.space.state_scale / noise_std)
        return cls(values.T, r / noise_std[:, None, None], noise_std, len(steps))

    def seen(self, weights: Array) -> Array:
        """The numbers of weights (…, n, k); shape (…, n, r)."""
        return np.einsum("nrk,...nk->...nr", self.roots, weights)

    def squares(self, weights: Array) -> Array:
        """Sums of squares of what weights (n, k) leave, less what noise makes of them; shape (n,)."""
        return np.sum((self.values - self.seen(weights)) ** 2, axis=1) - self.values.shape[1]


class SizeFit(NamedTuple):
    """Sizes of p causes, for one standard deviation of the weights of the rest.

    Attributes:
        log_evidence: Logarithm of the probability density of the errors.
        sizes: Expected sizes; shape (p,) [usual sizes].
        covariance: Shape (p, p).
        cosines: Cosines of the signatures over the steps of the run, rest and noise taken into account; shape (p, p).
    """

    log_evidence: float
    sizes: Array
    covariance: Array
    cosines: Array


def fit_sizes(error: RunError, none: Surface, signatures: Array, rest: float) -> SizeFit:
    """Sizes of causes by Bayesian linear regression.

    Args:
        none: Error of the simulated robot without gap.
        signatures: Change of the error per size of each cause; shape (p, n, k).
        rest: Standard deviation of the weights of the rest.
    """
    log = 0.0
    rows = list[Array]()
    for root, covariance, value, columns in zip(
        error.roots,
        none.covariance,
        error.values - error.seen(none.weights),
        np.moveaxis(error.seen(signatures), 0, -1),
        strict=True,
    ):
        # value = columns · sizes + N(0, I + root (covariance + rest² I) rootᵀ), divided by the root of that
        unknown = covariance + rest**2 * np.eye(root.shape[1])
        factor = np.linalg.cholesky(np.eye(len(root)) + root @ unknown @ root.T)
        log -= float(np.sum(np.log(np.diag(factor))))
        rows.append(np.linalg.solve(factor, np.column_stack([value, columns])))
    sizes = Weights.of_moments(np.zeros((1, len(signatures))), PRIOR_SIZE**2 * np.eye(len(signatures))[None])
    for value, *row in np.concatenate(rows):
        features = np.array(row)
        mean, variance = sizes.predicted(features)
        log += float(log_density(value - mean, np.sqrt(1 + variance))[0])
        sizes = sizes.learned(features, np.array([value]), np.ones(1))
    columns = np.concatenate(rows)[:, 1:]
    length = np.maximum(np.linalg.norm(columns, axis=0), 1e-9)
    cosines = np.clip(columns.T @ columns / np.outer(length, length), -1, 1)
    return SizeFit(log, sizes.mean[0], sizes.covariance[0], cosines)


def most_probable(error: RunError, none: Surface, signatures: Array) -> SizeFit:
    """The fit with the most probable rest."""
    return max((fit_sizes(error, none, signatures, rest) for rest in RESTS), key=lambda fit: fit.log_evidence)


class CauseSize(NamedTuple):
    """What a run says of a cause.

    Attributes:
        cause: The cause.
        share: Its size, where all causes may act [usual sizes].
        std: Standard deviation of that.
        alone: The size that it would have if it acted alone.
        explained: Share of the squared difference that it explains alone.
    """

    cause: Cause
    share: float
    std: float
    alone: float
    explained: float

    @property
    def value(self) -> float:
        """Its value, where all causes may act."""
        return self.cause.value(self.share)

    @property
    def interval(self) -> tuple[float, float]:
        """Ends of the 95 % interval of its value."""
        ends = [self.cause.value(self.share + sign * INTERVAL_95 * self.std) for sign in (-1, 1)]
        return min(ends), max(ends)

    @property
    def acts(self) -> bool:
        """Whether the 95 % interval of its size is on one side of zero, and the size is valid."""
        return abs(self.share) > INTERVAL_95 * self.std and (self.share > 0 or self.cause.signed)


@final
@dataclass(frozen=True, eq=False)
class Explanation:
    """What the error of a run says about the robot.

    Attributes:
        causes: Sizes of the causes that the run sees, first those that explain most.
        difference: Root mean square, without noise, by which the errors of the run differ from those of the simulated
            robot without gap; shape (n,) [half ranges].
        rest: Share of the squared difference that all causes together do not explain.
        rest_log_odds: Logarithm of the odds that there is such a rest, against noise and inaccurate simulation.
        alike: Groups of causes that the run cannot tell apart, since their signatures are alike.
        unseen: Causes of which the run says nothing.
        failed: Causes of usual size with which the simulated robot does not walk.
    """

    causes: tuple[CauseSize, ...]
    difference: Array
    rest: float
    rest_log_odds: float
    alike: tuple[tuple[Cause, ...], ...]
    unseen: tuple[Cause, ...]
    failed: tuple[Cause, ...]

    @property
    def has_rest(self) -> bool:
        """Whether a part of the error is none of the causes."""
        return self.rest_log_odds > REST_LOG_ODDS and self.rest > 0.05


Simulate = Callable[[Sequence[tuple[Shares, int]]], Sequence[Surface | None]]
"""Errors of robots with causes of these sizes; None for a robot that fell. Those of one number have the same targets
and noise, so that these do not add to their difference."""


def explain_error(error: RunError, causes: Sequence[Cause], simulate: Simulate) -> Explanation:
    """Finds the sizes of causes that explain the errors of a run.

    Raises:
        InputError: The simulated robot falls without gap, or with each of the causes.
    """
    none, signatures = find_signatures(error, causes, simulate)
    walked = [cause for cause in causes if cause.name in signatures]
    rows = np.array([signatures[cause.name] for cause in walked])
    together = most_probable(error, none, rows)
    squares = np.maximum(error.squares(none.weights), 0.0)
    total = max(float(squares.sum()), 1e-9)

    def left(sizes: Array, signatures: Array) -> float:
        weights = none.weights + np.tensordot(sizes, signatures, 1)
        return float(np.clip(error.squares(weights).sum() / total, 0.0, 1.0))

    sizes = list[CauseSize]()
    seen = list[int]()
    for number, cause in enumerate(walked):
        signature = rows[number : number + 1]
        alone = most_probable(error, none, signature)
        if alone.covariance[0, 0] < UNSEEN_STD**2:
            seen.append(number)
            std = float(np.sqrt(together.covariance[number, number]))
            explained = 1 - left(alone.sizes, signature)
            share = float(together.sizes[number])
            sizes.append(CauseSize(cause, share, std, alone=float(alone.sizes[0]), explained=explained))
    groups = alike_groups(together.cosines[np.ix_(seen, seen)], [walked[number] for number in seen])
    return Explanation(
        tuple(sorted(sizes, key=lambda size: -size.explained)),
        error.noise_std * np.sqrt(squares / error.steps),
        left(together.sizes, rows),
        together.log_evidence - fit_sizes(error, none, rows, RESTS[0]).log_evidence,
        tuple(group for group in groups if len(group) > 1),
        tuple(cause for number, cause in enumerate(walked) if number not in seen),
        tuple(cause for cause in causes if cause not in walked),
    )


def find_signatures(
    error: RunError, causes: Sequence[Cause], simulate: Simulate
) -> tuple[Surface, Mapping[str, Array]]:
    """Error of the simulated robot without gap, and change of it by each cause with which it walks, per size (n, k).

    Each cause is simulated alone, at its usual size, and then at the size that it would have alone, since half a
    millisecond of delay does not do half of what a millisecond does.

    Raises:
        InputError: The robot falls without gap, or with each of the causes.
    """
    nones = [surface for surface in simulate([({}, 0), ({}, 1)]) if surface]
    if len(nones) < 2:
        raise InputError("the simulated robot without gap falls, so nothing can be compared with it")
    none = nones[0]._replace(
        weights=(nones[0].weights + nones[1].weights) / 2, covariance=(nones[0].covariance + nones[1].covariance) / 4
    )

    def signatures(shares: Shares, number: int) -> dict[str, Array]:
        surfaces = simulate([({name: share}, number) for name, share in shares.items()])
        pairs = zip(shares.items(), surfaces, strict=True)
        return {name: (one.weights - nones[number].weights) / share for (name, share), one in pairs if one}

    # At the usual size or, where the robot falls, at a third of it
    usual = signatures({cause.name: 1.0 for cause in causes}, 0)
    usual |= signatures({cause.name: 0.3 for cause in causes if cause.name not in usual}, 0)
    if not usual:
        names = ", ".join(cause.name for cause in causes)
        raise InputError(f"the simulated robot falls with a usual size of each of the possible causes: {names}")
    # At the size that follows
    alone = {name: float(most_probable(error, none, change[None]).sizes[0]) for name, change in usual.items()}
    sizes = {cause.name: _simulated_size(cause, alone[cause.name]) for cause in causes if cause.name in usual}
    return none, {**usual, **signatures(sizes, 1)}


def _simulated_size(cause: Cause, size: float) -> float:
    """The size next to one that is valid, neither too small nor too large to simulate, and on the same side of zero."""
    side = -1.0 if size < 0 and cause.least <= -SMALLEST_SIMULATED else 1.0
    amount = float(np.clip(side * size, SMALLEST_SIMULATED, LARGEST_SIMULATED))
    return float(np.clip(side * amount, cause.least, cause.most))


def alike_groups(cosines: Array, causes: Sequence[Cause]) -> list[tuple[Cause, ...]]:
    """Groups of causes whose signatures have a cosine of at least `ALIKE` (complete linkage).

    Args:
        cosines: Cosines of their signatures; shape (p, p). That of causes that act in opposite directions is negative;
            they are alike if a size may be negative.
        causes: The p causes.
    """
    if len(causes) < 2:
        return [(cause,) for cause in causes]
    signed = np.array([cause.signed for cause in causes])
    distance = 1 - np.where(signed[:, None] | signed, np.abs(cosines), cosines)
    np.fill_diagonal(distance, 0.0)
    labels = fcluster(linkage(squareform(distance, checks=False), "complete"), 1 - ALIKE, "distance").tolist()
    return [
        tuple(cause for cause, own in zip(causes, labels, strict=True) if own == label)
        for label in dict.fromkeys(labels)
    ]
