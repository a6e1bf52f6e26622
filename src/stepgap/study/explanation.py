"""What the error of a run says about the robot: groups of differences from its model that explain the error.

The error of the nominal map, over state and command, is a quadratic polynomial for each state coordinate. Its
*signature* of a difference is how the polynomial of a simulated robot changes when that one difference is set. Causes
are found one after the other by evidence (marginal likelihood, MacKay, Information Theory, Inference, and Learning
Algorithms, Ch. 28). As signatures bend with their size, each cause is simulated again at the size found (Gauss–Newton):

    error of the run = error of the simulated robot + signatures · (sizes − those simulated) + rest + noise

The rest is what no cause explains: a polynomial whose weights have an unknown common variance, over which sizes and
evidence are averaged. So intervals are wider where the causes do not explain everything. Differences whose signatures
are alike over the steps of the run, or that make its errors about as probable, are a *group*, within which this run
cannot tell which one it is.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Final, NamedTuple, final

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from stepgap.base.errors import InputError
from stepgap.base.normal import INTERVAL_95
from stepgap.step import Array
from stepgap.study.cause_sizes import RESTS, Cause, RunError, Shares, SizeFit, Surface, fit_sizes

ALIKE: Final = 0.9
"""Cosine of signatures from which on differences are in one group."""

CAUSE_LOG_ODDS: Final = 3.0
"""Logarithm of the odds by which a further cause must make the errors more probable."""

MOST_GROUPS: Final = 3
"""Largest number of groups that are found."""

MOST_SIMULATED: Final = 6
"""Number of causes, the most probable by the signatures known so far, that are simulated at the size found."""

LEAST_SIGNATURE: Final = 3.0
"""Size of a signature from which on a run sees it [noise]; of two simulations of one hopper, 12 % differ by more."""

MOST_USUAL: Final = 4.0
"""Largest size at which a cause is simulated to compare signatures [usual sizes]."""

BENDING: Final = 0.3
"""Usual change of a signature between two sizes, relative to the signature [1 / usual size]."""

SIMULATED_ROUNDS: Final = 3
"""How often a robot is simulated at the sizes found, and the robot without gap at the start."""

HOPELESS: Final = 8.0
"""Logarithm of the odds by which a cause may be less probable than the best one and still be simulated again."""

TOLD_APART: Final = 5.0
"""Logarithm of the odds from which on causes of a group are told apart.

Another seed of the simulations changes it by some 2 to 5 (standard deviations of causes of the hopper).
"""


class Member(NamedTuple):
    """A cause of a group, with the size that it would have.

    Attributes:
        cause: The cause.
        share: Its size, in usual sizes.
        std: Standard deviation of that.
        log_odds: Logarithm of the probability density of the errors with it, less that with the first of the group.
    """

    cause: Cause
    share: float
    std: float
    log_odds: float

    @property
    def value(self) -> float:
        """Its value."""
        return self.cause.value(self.share)

    @property
    def interval(self) -> tuple[float, float]:
        """Ends of the 95 % interval of its value."""
        low, high = (self.share + sign * INTERVAL_95 * self.std for sign in (-1, 1))
        ends = [self.cause.value(max(low, self.cause.least)), self.cause.value(min(high, self.cause.most))]
        return min(ends), max(ends)


class CauseGroup(NamedTuple):
    """Causes of which one explains a part of the error, and which this run cannot tell apart.

    Attributes:
        members: The causes, the most probable one first.
        log_odds: Logarithm of the odds for it, against no such cause.
        explained: Share of the squared difference that it explains beyond the groups before it.
    """

    members: tuple[Member, ...]
    log_odds: float
    explained: float


@final
@dataclass(frozen=True, eq=False)
class Explanation:
    """What the error of a run says about the robot.

    Attributes:
        groups: Groups of causes, as they were found.
        difference: Root mean square, without noise, by which the errors of the run differ from those of the simulated
            robot without gap; shape (n,) [half ranges].
        rest: Share of the squared difference that none of the groups explains.
        rest_log_odds: Logarithm of the odds that there is such a rest, against noise and inaccurate simulation.
        alike: Groups of all causes that the run can see.
        unseen: Causes of usual size that the run does not see.
        failed: Causes of usual size with which the simulated robot does not walk.
    """

    groups: tuple[CauseGroup, ...]
    difference: Array
    rest: float
    rest_log_odds: float
    alike: tuple[tuple[Cause, ...], ...]
    unseen: tuple[Cause, ...]
    failed: tuple[Cause, ...]

    @property
    def has_rest(self) -> bool:
        """Whether a part of the error is none of the causes."""
        return self.rest_log_odds > CAUSE_LOG_ODDS and self.rest > 0.05


Simulate = Callable[[Sequence[Shares]], Sequence[Surface | None]]
"""Errors of robots with causes of these sizes, each with a scatter of its own; None for a robot that fell."""


def alike_groups(signatures: Array, causes: Sequence[Cause]) -> list[int]:
    """Number of the group of each cause, by the cosines of their signatures (complete linkage).

    Args:
        signatures: Products of signatures over the steps of a run, as `signature_products` gives them; shape (p, p).
        causes: The p causes.
    """
    if len(causes) < 2:
        return [1] * len(causes)
    length = np.sqrt(np.maximum(signatures.diagonal(), 1e-12))
    cosine = np.clip(signatures / np.outer(length, length), -1, 1)
    signed = np.array([each.signed for each in causes])
    either = signed[:, None] | signed[None]
    distance = 1 - np.where(either, np.abs(cosine), cosine)
    np.fill_diagonal(distance, 0.0)
    return fcluster(linkage(squareform(distance, checks=False), "complete"), 1 - ALIKE, "distance").tolist()


def signature_products(error: RunError, spread: Array, changes: Sequence[Array]) -> Array:
    """Products of changes of the simulated error, less what the inaccuracy of simulations makes of them; shape (p, p).

    The metric is that of the noise of the run and of two simulations, of which one is the same for all changes.

    Args:
        error: Errors of the run.
        spread: Covariances of the weights of a simulation; shape (n, k, k).
        changes: The p changes; each (n, k).
    """
    rows, inaccuracy = [], 0.0
    for root, own, weights in zip(error.roots, spread, np.array(changes).swapaxes(0, 1), strict=True):
        simulated = 2 * root @ own @ root.T
        factor = np.linalg.cholesky(np.eye(len(root)) + simulated)
        rows.append(np.linalg.solve(factor, root @ weights.T))
        inaccuracy += float(np.trace(np.linalg.solve(factor @ factor.T, simulated)))
    h = np.concatenate(rows)
    return h.T @ h - inaccuracy * (0.5 + 0.5 * np.eye(h.shape[1]))


class _Slope(NamedTuple):
    """A signature: change of the error by a change of a size, and its covariance, in those of one simulation."""

    weights: Array
    inaccuracy: float


class _Change(NamedTuple):
    """Change of the error by a cause of some size."""

    share: float
    weights: Array


@final
@dataclass(frozen=True, eq=False)
class _Point:
    """A simulated robot with sizes of causes, and the sizes that follow from it by signatures."""

    shares: Shares
    surface: Surface
    slopes: Mapping[str, _Slope]
    fit: SizeFit

    def std(self, name: str) -> float:
        return float(np.sqrt(self.fit.covariance.diagonal()[list(self.shares).index(name)]))

    @property
    def next(self) -> Shares:
        """The sizes found."""
        return dict(zip(self.shares, self.fit.sizes.tolist(), strict=True))


class _Search:
    """Simulations about a run, and the signatures that are known from them."""

    def __init__(self, error: RunError, causes: Sequence[Cause], simulate: Simulate):
        self.error, self.simulate = error, simulate
        self.causes = {each.name: each for each in causes}
        nones = [each for each in simulate([{}] * SIMULATED_ROUNDS) if each is not None]
        if not nones:
            raise InputError("the simulated robot without gap falls, so nothing can be compared with it")
        covariance = np.mean([each.covariance for each in nones], axis=0)
        self.noise = error.spread(covariance)
        self.none = Surface(np.mean([each.weights for each in nones], axis=0), covariance / len(nones))
        self.changes: dict[str, list[_Change]] = {}
        self.points: dict[tuple[frozenset[str], str], _Point] = {}

    def simulate_usual(self) -> None:
        """Simulates each cause at its usual size or, where the robot falls, at a third of it."""
        for share in (1.0, 0.3):
            self._keep({name: share for name in self.causes if name not in self.changes})

    def simulate_whole(self) -> None:
        """Simulates each cause at the size at which its effect is as large as the error that is to be explained.

        One that seems to lie on the other side of no difference then is simulated there, too.
        """
        wanted = dict[str, float]()
        error = max(float(self.error.squares(self.none.weights).sum()), 0.0)
        for name in self.changes:
            share = float(np.sqrt(error / max(self.error.effect(self.slope(name, 1.0).weights), 1e-12)))
            wanted[name] = float(np.clip(share, 0.3, MOST_USUAL))
        self._keep(self.shortened(wanted))
        signed = [name for name in wanted if self.causes[name].signed]
        backward = [name for name in signed if self.fitted({name: 0.0}, self.none).next[name] < 0]
        self._keep(self.shortened({name: -wanted[name] for name in backward}))

    def _keep(self, wanted: Shares) -> None:
        """Keeps the signatures of causes of some sizes, each alone."""
        for name, found in zip(wanted, self.simulate([{name: wanted[name]} for name in wanted]), strict=True):
            if found is not None:
                change = _Change(wanted[name], found.weights - self.none.weights)
                self.changes.setdefault(name, []).append(change)

    def slope(self, name: str, share: float) -> _Slope:
        """The signature of a cause about a size.

        It is the mean of what was found at all sizes, weighted by the inverse of the variance there: that of the
        simulations, and what signatures usually bend between that size and this one.
        """
        shares = np.array([each.share for each in self.changes[name]])
        secants = np.array([each.weights / each.share for each in self.changes[name]])
        without = self.error.spread(self.none.covariance) / self.noise
        inaccuracy = (1 + without) * self.noise / shares**2
        largest = int(np.argmax(np.abs(shares)))
        square = max(self.error.effect(secants[largest]) - float(inaccuracy[largest]), 0.0)
        weights = 1 / (inaccuracy + (BENDING * (shares - share)) ** 2 * square)
        weights /= weights.sum()
        parts = weights / shares  # of each simulation; that without causes has their sum
        return _Slope(np.einsum("i,ink->nk", weights, secants), float(np.sum(parts**2) + without * np.sum(parts) ** 2))

    def fitted(
        self, shares: Shares, surface: Surface, slopes: Mapping[str, _Slope] | None = None, rests: Array = RESTS
    ) -> _Point:
        """The sizes that follow from a simulated robot, by the present signatures or others."""
        near = {name: share or self.changes[name][-1].share for name, share in shares.items()}
        known = slopes or {name: self.slope(name, share) for name, share in near.items()}
        rows = np.array([known[name].weights for name in shares]).reshape(len(shares), *surface.weights.shape)
        unit = self.noise / self.error.spread(surface.covariance)
        inaccuracy = unit * np.array([known[name].inaccuracy for name in shares])
        sizes = np.array([*shares.values()])
        return _Point(shares, surface, known, fit_sizes(self.error, surface, sizes, rows, inaccuracy, rests))

    def predicted(self, point: _Point, shares: Shares) -> Array:
        """Error of the robot with some sizes, by the signatures of a point; shape (n, k)."""
        changes = [point.slopes[name].weights * (share - point.shares[name]) for name, share in shares.items()]
        return point.surface.weights + np.sum(changes, axis=0)

    def joined(self, before: _Point, shares: Shares, surface: Surface) -> Surface:
        """The mean of a simulated robot and of what the point before predicts for its sizes, by inverse variances.

        The variance of the prediction is that of its robot and signatures and, where they differ by more than these
        explain, because signatures bend, what else there is.
        """
        other = self.predicted(before, shares)
        steps = np.array([shares[name] - before.shares[name] for name in shares])
        variance = self.error.spread(before.surface.covariance) / self.noise
        variance += float(steps**2 @ [before.slopes[name].inaccuracy for name in shares])
        variance = max(variance, self.error.effect(surface.weights - other) / self.noise - 1)
        own = variance / (1 + variance)
        return Surface(own * surface.weights + (1 - own) * other, own * surface.covariance)

    def permitted(self, shares: Shares) -> bool:
        """Whether sizes are on a side where some are valid."""
        return all(self.causes[name].signed or share > 0 for name, share in shares.items())

    def shortened(self, shares: Shares) -> Shares:
        """The valid sizes that are next to these."""
        return {
            name: float(np.clip(share, self.causes[name].least, self.causes[name].most))
            for name, share in shares.items()
        }

    def walked(self, starts: Sequence[tuple[_Point, str]]) -> dict[str, _Point]:
        """Simulates robots with one cause more, at the sizes found, some times; by the name of that cause."""
        points = {name: self.fitted({**start.shares, name: 0.0}, start.surface) for start, name in starts}
        origins = {name: start for start, name in starts}
        found = dict[str, _Point]()
        for _ in range(SIMULATED_ROUNDS):
            best = max((point.fit.log_evidence for point in found.values()), default=-inf)
            points = {
                name: point
                for name, point in points.items()
                if self.permitted(point.next) and point.fit.log_evidence > best - HOPELESS
            }
            wanted = {name: self.shortened(point.next) for name, point in points.items()}
            for name, surface in zip(wanted, self.simulate([*wanted.values()]), strict=True):
                if surface is None:
                    points.pop(name)
                    continue
                self._learn(name, wanted[name], surface, origins[name])
                points[name] = self.fitted(wanted[name], self.joined(points[name], wanted[name], surface))
                found[name] = points[name]
        found = {name: point for name, point in found.items() if point.next == self.shortened(point.next)}
        self.points |= {(frozenset(origins[name].shares), name): point for name, point in found.items()}
        return found

    def _learn(self, name: str, shares: Shares, surface: Surface, origin: _Point) -> None:
        """Keeps the signature of a cause at the size simulated, after the signatures of the others were taken off."""
        change = surface.weights - origin.surface.weights
        for each in shares:
            if each != name:
                change = change - origin.slopes[each].weights * (shares[each] - origin.shares[each])
        self.changes[name].append(_Change(shares[name], change))


def explain_error(error: RunError, causes: Sequence[Cause], simulate: Simulate) -> Explanation:
    """Finds the causes that explain the errors of a run.

    Args:
        error: Errors of the run.
        causes: Causes that are possible.
        simulate: Simulates robots with some causes.

    Raises:
        InputError: The simulated robot falls without gap, or with each of the causes.
    """
    search = _Search(error, causes, simulate)
    search.simulate_usual()
    search.simulate_whole()
    walked = [each for each in causes if each.name in search.changes]
    if not walked:
        names = ", ".join(each.name for each in causes)
        raise InputError(f"the simulated robot falls with a usual size of each of the possible causes: {names}")
    largest = [max(search.changes[each.name], key=lambda change: abs(change.share)) for each in walked]
    signatures = signature_products(
        error, SIMULATED_ROUNDS * search.none.covariance, [each.weights for each in largest]
    )
    visible = signatures.diagonal() > LEAST_SIGNATURE**2
    seen = [each for each, one in zip(walked, visible, strict=True) if one]
    labels = dict(zip(seen, alike_groups(signatures[np.ix_(visible, visible)], seen), strict=True))
    now = search.fitted({}, search.none)
    path, gains, groups_of, possible = [now], list[tuple[str, float]](), dict[str, set[str]](), seen
    while len(gains) < MOST_GROUPS and (more := _with_one_more(search, now, [each.name for each in possible])):
        name, point, near = more
        gains.append((name, point.fit.log_evidence - now.fit.log_evidence))
        label = labels[search.causes[name]]
        groups_of[name] = near | {each.name for each in seen if labels[each] == label}
        possible = [each for each in possible if labels[each] != label]  # one cause of a group has the size of all
        now = point
        path.append(now)
    squares = np.maximum(error.squares(search.none.weights), 0.0)
    total = max(float(squares.sum()), 1e-9)
    left = [float(np.clip(error.squares(search.predicted(each, each.next)).sum() / total, 0.0, 1.0)) for each in path]
    groups = []
    for number, (name, gain) in enumerate(gains):
        members = _members(search, now, name, [each for each in seen if each.name in groups_of[name]])
        groups.append(CauseGroup(members, gain, max(left[number] - left[number + 1], 0.0)))
    without = search.fitted(now.shares, now.surface, now.slopes, rests=RESTS[:1]).fit.log_evidence
    return Explanation(
        tuple(groups),
        error.noise_std * np.sqrt(squares / error.steps),
        left[-1],
        now.fit.log_evidence - without,
        tuple(tuple(each for each in seen if labels[each] == label) for label in dict.fromkeys(labels.values())),
        tuple(each for each in walked if each not in seen),
        tuple(each for each in causes if each not in walked),
    )


def _with_one_more(search: _Search, now: _Point, names: Sequence[str]) -> tuple[str, _Point, set[str]] | None:
    """The most probable further cause, simulated at the size found, and all that are nearly as probable.

    None if none is probable enough.
    """
    points = {name: search.fitted({**now.shares, name: 0.0}, now.surface) for name in names if name not in now.shares}
    likely = [name for name, point in points.items() if point.fit.log_evidence > now.fit.log_evidence]
    possible = [name for name in likely if search.permitted(points[name].next)]
    possible.sort(key=lambda name: -points[name].fit.log_evidence)
    found = search.walked([(now, name) for name in possible[:MOST_SIMULATED]])
    if not found:
        return None
    best = max(found, key=lambda name: found[name].fit.log_evidence)
    if found[best].fit.log_evidence - now.fit.log_evidence < CAUSE_LOG_ODDS:
        return None
    near = {name for name, point in found.items() if point.fit.log_evidence > found[best].fit.log_evidence - TOLD_APART}
    return best, found[best], near


def _members(search: _Search, now: _Point, name: str, group: Sequence[Cause]) -> tuple[Member, ...]:
    """What each cause of a group would have as its size, in place of the one that was found."""
    others = {each: share for each, share in now.shares.items() if each != name}
    base = search.simulate([others])[0] if others else search.none
    points = {name: now}
    if base is not None:
        start = search.fitted(others, base)
        wanted = [each.name for each in group if each.name not in now.shares]
        known = {each: search.points.get((frozenset(others), each)) for each in wanted}
        points |= {each: point for each, point in known.items() if point}
        points |= search.walked([(start, each) for each in wanted if not known[each]])
    best = max(point.fit.log_evidence for point in points.values())
    members = [
        Member(search.causes[each], point.next[each], point.std(each), point.fit.log_evidence - best)
        for each, point in points.items()
    ]
    return tuple(sorted(members, key=lambda each: -each.log_odds))
