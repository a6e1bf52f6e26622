"""All that is known of a robot's error: a few beliefs that compete by how probable they make its steps.

Beliefs differ in where they begin. Before a step each of them predicts its error. After it, the weight of each is
multiplied by the density that it gave to the error (multiple-model estimation: Blom and Bar-Shalom, The interacting
multiple model algorithm, 1988), and each learns the step. That density is a mixture of three explanations:

- the step was *regular*: Student's t with the belief's own mean and variance;
- it was *wrong*: a push, or a wrong measurement of the state at its end: much wider, with heavy tails;
- the step *before* was measured wrongly, so that this one began elsewhere, namely where the step before was predicted
  to end: it is as regular as any other, from there.

A robot may change before any step. Then the most probable belief, widened by a part of what robots differ by, is born
as another one. It becomes the current one as soon as it is the most probable by far, and what was believed before is
kept for the case that the robot changes back.

The features are common to all beliefs, so the moments of their mixture are exact, and it is their mixture that plans: a
belief that may be right makes the map uncertain where it disagrees with the others, and cautious control stays away.

`docs/learning.md` has the equations, and says by which measurement each number here was chosen.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import exp, inf, log
from typing import Final, NamedTuple, Self, final

import numpy as np

from stepgap.gauss.features import Features
from stepgap.gauss.student import log_student
from stepgap.gauss.weights import Predicted
from stepgap.learning.belief import Belief, Kind
from stepgap.learning.first_beliefs import PERIODIC_STD, RATES, Family, first_beliefs
from stepgap.step import Array

RUN_COUNT: Final = 50.0  # Number of steps that the noise of an earlier run is worth at most
RUN_FAR = 4.0
RUN_TRUST = 0.01
"""A step of it whose error is further off than so many deviations counts so much."""
CHANGED_PART: Final = 0.25  # Part of the covariance between robots by which a robot changes
HAZARD = 3e-4
RETURN_HAZARD = 1e-3
FIRST_HAZARD = 3e-3
"""Probability of a change before a step, of a return to what was before, and of a change between two deployments. The
last is below `LEAST_WEIGHT`, so that a change plans no step before one spoke for it."""
WRONG: Final = 0.02  # Probability of a push or a wrong measurement in a step
WRONG_WIDTH = 10.0
WRONG_FREEDOM = 2.0
"""Width of the error of such a step, in noise deviations, and its degrees of freedom: its tails are heavy, or a single
large jump would make a newborn belief certain."""
SUSPECT: Final = 0.1  # From this probability of a wrong step on, the next one may have begun elsewhere
WRONG_MEASUREMENTS: Final = (0.1, 0.9)
"""Numbers of wrong steps that were, and were not, wrong measurements, before the first one."""
ACCIDENTS = 2
WIDER = 16.0
WIDENINGS = 4
"""So many wrong steps in a row may be accidents. Each further one makes a change this much wider [variance], so many
times: otherwise no belief would learn a change that is large beside what robots differ by."""
LEAST_TRUST: Final = 1e-3
"""A wrong step is learned with at least this weight, unless its error is larger than those of wrong steps."""
LEAST_WEIGHT: Final = 0.01
"""A belief that is less probable does not plan. With a tenth, a belief that was surer and wrong planned a hop alone."""
SAME_MEAN = 0.3
SAME_SPREAD = 0.5
"""Beliefs are one if their predictions differ by less than this part of their standard deviation, and their variances
by less than this factor's logarithm, at `PROBES` points and at the latest steps."""
PROBES = 12
RECENT = 4
"""Numbers of these points and steps."""
MOST = 10
YOUNG = 3
"""Number of beliefs that are kept, and the age up to which a belief is kept besides: it could not yet speak."""
REPORTED_ODDS = 30.0
SUDDEN = 10
"""A change is reported from these odds on, within this number of steps from its beginning: a belief that wins later is
a better model, not a change."""


class Observed(NamedTuple):
    """A step as beliefs see it.

    Attributes:
        point: State, command and context inputs [half ranges]; shape (d,).
        error: Of the nominal map [half ranges]; shape (n,).
        phase: At which it started [rad], NaN if it is unknown.
        command: Of the step [half ranges]; shape (m,).
        from_elsewhere: Point, error and ∂error/∂state of the step if its true start was the measured one less an offset
            (n,) [half ranges]; None where the nominal map makes no step.
    """

    point: Array
    error: Array
    phase: float
    command: Array
    from_elsewhere: Callable[[Array], tuple[Array, Array, Array] | None]


class Suspicion(NamedTuple):
    """What is known of the step before, which was probably wrong.

    Attributes:
        wrong: Probability that it was wrong.
        measured_wrongly: Probability that its end was measured wrongly, by `offset`.
        offset: Measured minus predicted end [half ranges]; shape (n,).
        variance: Of that prediction [half ranges²]; shape (n,).
        in_a_row: Number of steps up to it that were rather wrong than not.
    """

    wrong: float
    measured_wrongly: float
    offset: Array
    variance: Array
    in_a_row: int


class Mixture(NamedTuple):
    """Moments of the beliefs that plan the next step [half ranges].

    Attributes:
        mean: Of the weights; shape (n, k).
        covariance: Shape (n, k, k).
        noise: Variance of the noise; shape (n,).
        side: Features of the step that do not depend on its state and command; shape (k − p,).
        offset: Measured minus expected state at its start; shape (n,).
    """

    mean: Array
    covariance: Array
    noise: Array
    side: Array
    offset: Array


@final
@dataclass(frozen=True, eq=False)
class Beliefs:
    """The beliefs between two steps; immutable. `start` makes the first ones, `after` those after a step.

    Attributes:
        features: Of state, command and context inputs.
        beliefs: The most probable one need not be the first.
        change: Covariance that a change adds to the weights; shape (n, k, k).
        before: Error and command of the step before, zero where there is none; shape (n + m,) [half ranges].
        suspicion: What is known of the step before if that was probably wrong.
        wrong_measurements: Numbers of wrong steps that were wrong measurements, and that were not.
        recent: Features of the latest steps; shape (≤ 4, k).
        alarm: Kind of the belief that became the current one with the latest step; None for none.
    """

    features: Features
    beliefs: tuple[Belief, ...]
    change: Array
    before: Array
    suspicion: Suspicion | None
    wrong_measurements: tuple[float, float]
    recent: Array
    alarm: Kind | None = None

    @classmethod
    def start(
        cls,
        features: Features,
        sizes: tuple[int, int],
        families: Sequence[Family],
        fitted: Array | None,
        lagged: bool = False,
    ) -> Self:
        """Returns the beliefs before the first step of a robot.

        Args:
            features: Of state, command and context inputs.
            sizes: Number of state coordinates n and of command coordinates m.
            families: Priors over robots, equally probable ones.
            fitted: Noise of a fitted residual, whose remaining error is believed about; shape (n,) [half ranges].
            lagged: Whether the command of the step before may act as much as that of the step.
        """
        beliefs = first_beliefs(features, sizes, families, fitted, lagged)
        size = beliefs[0].weights.mean.shape[1]
        between_robots = beliefs[0] if fitted is None else beliefs[len(RATES)]
        change = CHANGED_PART * between_robots.weights.covariance
        before = np.zeros(sum(sizes))
        return cls(features, beliefs, change, before, None, WRONG_MEASUREMENTS, np.empty((0, size)))

    def with_runs(self, runs: Sequence[Sequence[tuple[Observed, bool]]]) -> "Beliefs":
        """The beliefs with earlier runs as further ones, which have half of the probability.

        Args:
            runs: The steps of each, and whether each follows the one before it.
        """
        begun = [self._after_run(steps, log(1 / len(runs))) for steps in runs]
        return replace(self, beliefs=(*self.beliefs, *begun))

    def _after_run(self, steps: Sequence[tuple[Observed, bool]], log_weight: float) -> Belief:
        """The belief that the robot is that of an earlier run."""
        beliefs = self
        belief = self.beliefs[0]
        for step, follows in steps:
            side = (beliefs if follows else beliefs._forgetting()).side(step.phase)
            features = self.all_features(step.point, side)
            mean, variance = belief.weights.predicted(features)
            far = float(np.max(np.abs(step.error - mean) / np.sqrt(variance + belief.noise)))
            trust = 1.0 if far <= RUN_FAR else RUN_TRUST * min(1.0, (WRONG_WIDTH / far) ** 2)
            belief = belief.learned(features, step.error, trust)
            beliefs = replace(beliefs, before=np.concatenate([step.error, step.command]))
        freedom = np.minimum(belief.freedom, RUN_COUNT)
        noise = belief.noise
        return Belief("run", belief.weights, freedom, noise * (freedom - 2), log_weight)

    def side(self, phase: float) -> Array:
        """Features of the next step that do not depend on its state and command; shape (2 + n + m,).

        Args:
            phase: At which it starts [rad], NaN if it is unknown.
        """
        return np.concatenate([np.nan_to_num([np.sin(phase), np.cos(phase)]), self.before])

    def all_features(self, point: Array, side: Array) -> Array:
        """All k features of a step."""
        return np.concatenate([self.features(point), side])

    @property
    def _walking(self) -> list[int]:
        """Places of the weights of constant and periodic part."""
        return [0, self.features.count, self.features.count + 1]

    @property
    def probabilities(self) -> Array:
        """Probability of each belief."""
        return _shares(np.array([belief.log_weight for belief in self.beliefs]))

    def mixture(self, phase: float) -> Mixture:
        """The mixture of the beliefs that plan the next step, which starts at a phase [rad]."""
        shares = self.probabilities
        kept = [
            (share, belief.walked(self._walking))
            for share, belief in zip(shares, self.beliefs, strict=True)
            if share > LEAST_WEIGHT or share == shares.max()
        ]
        total = sum(share for share, _ in kept)
        mean = sum(share / total * belief.weights.mean for share, belief in kept)
        covariance = np.zeros_like(self.change)
        noise = np.zeros(len(self.change))
        for share, belief in kept:
            away = belief.weights.mean - mean
            covariance += share / total * (belief.weights.covariance + away[:, :, None] * away[:, None, :])
            noise += share / total * belief.noise
        doubt = self.suspicion
        offset = doubt.measured_wrongly * doubt.offset if doubt else np.zeros(len(noise))
        return Mixture(np.asarray(mean), covariance, noise, side=self.side(phase), offset=offset)

    def redeployed(self) -> "Beliefs":
        """The beliefs before another deployment: the robot may have changed, and the zero of the phase is another."""
        places = self._walking[1:]
        fresh = []
        for belief in self.beliefs:
            if belief.kind == "earlier":
                continue
            periodic = np.tile(PERIODIC_STD**2 * belief.noise[:, None], (1, 2))
            weights = belief.weights.restarted(places, periodic).walked([0], belief.noise)
            fresh.append(replace(belief, weights=weights))
        changed = self._changed(fresh[0], log(FIRST_HAZARD))
        return replace(self._forgetting(), beliefs=(*fresh, changed), recent=self.recent[:0], alarm=None)

    def _forgetting(self) -> "Beliefs":
        """Nothing is known of the step before."""
        return replace(self, before=np.zeros_like(self.before), suspicion=None)

    def with_command_before(self, command: Array) -> "Beliefs":
        """The beliefs where the command before the next step is known, whether or not that step was learned.

        Args:
            command: Shape (m,) [half ranges].
        """
        return replace(self, before=np.concatenate([self.before[: len(self.change)], command]))

    def unlinked(self) -> "Beliefs":
        """The beliefs after a step whose error is not known."""
        return replace(self._forgetting(), alarm=None)

    def _changed(self, belief: Belief, log_weight: float, factor: float = 1.0) -> Belief:
        """The belief that the robot has just changed, by a multiple of the usual covariance."""
        weights = belief.weights.widened(factor * self.change)
        return replace(belief, kind="changed", weights=weights, log_weight=log_weight, rate=0.0, age=0)

    @property
    def _wrong_in_a_row(self) -> int:
        return self.suspicion.in_a_row if self.suspicion else 0

    def taught(self, step: Observed) -> "Beliefs":
        """The beliefs after a step that is learned without a judgement, such as the first one of a plant."""
        features = self.all_features(step.point, self.side(step.phase))
        beliefs = tuple(belief.learned(features, step.error, 1.0) for belief in self.beliefs)
        before = np.concatenate([step.error, step.command])
        return replace(self, beliefs=beliefs, before=before, suspicion=None, alarm=None)

    def after(self, step: Observed) -> "Beliefs":
        """The beliefs after a step."""
        beliefs = [belief.walked(self._walking) for belief in self.beliefs]
        best = max(beliefs, key=lambda belief: belief.log_weight)
        settled = max(
            (belief for belief in beliefs if belief.kind not in ("changed", "earlier")),
            key=lambda belief: belief.log_weight,
            default=best,
        )
        if len(self.recent):
            least = best.log_weight + log(RETURN_HAZARD)
            beliefs = [
                replace(belief, log_weight=max(belief.log_weight, least)) if belief.kind == "earlier" else belief
                for belief in beliefs
            ]
            widenings = min(max(0, self._wrong_in_a_row - ACCIDENTS), WIDENINGS)
            beliefs.append(self._changed(best, best.log_weight + log(HAZARD), WIDER**widenings))
        features = self.all_features(step.point, self.side(step.phase))
        elsewhere = self._elsewhere(step)
        judged = _judged(beliefs, best, features, step.error, elsewhere)
        return self._settled(judged, best, settled, features, step, elsewhere)

    def _elsewhere(self, step: Observed) -> "_Elsewhere | None":
        """The step as it was if the one before was measured wrongly."""
        doubt = self.suspicion
        if doubt is None or (moved := step.from_elsewhere(doubt.offset)) is None:
            return None
        point, error, slope = moved
        unknown = replace(self, before=np.concatenate([0 * error, self.before[len(error) :]]))
        features = self.all_features(point, unknown.side(step.phase))
        return _Elsewhere(doubt.measured_wrongly, features, error, (slope**2) @ doubt.variance)

    def _settled(
        self,
        judged: "_Judged",
        best: Belief,
        settled: Belief,
        features: Array,
        step: Observed,
        elsewhere: "_Elsewhere | None",
    ) -> "Beliefs":
        """The beliefs after their judgement: one may become the current one, equal ones are joined."""
        yes, no = self.wrong_measurements
        if elsewhere is not None and self.suspicion is not None:
            yes = yes + judged.elsewhere
            no = no + max(0.0, self.suspicion.wrong - judged.elsewhere)
        suspicion = None
        if judged.wrong > SUSPECT:
            mean, variance = best.weights.predicted(features)
            suspicion = Suspicion(
                judged.wrong,
                judged.wrong * yes / (yes + no),
                step.error - mean,
                variance + best.noise,
                in_a_row=self._wrong_in_a_row + 1 if judged.wrong > 1 / 2 else 0,
            )
        beliefs, alarm = _reported(judged.beliefs, settled)
        recent = np.vstack([self.recent, features])[-RECENT:]
        right = 1 - suspicion.measured_wrongly if suspicion else 1.0
        probed = np.hstack([self.features(self.probes), np.zeros((PROBES, 2 + len(self.before)))])
        return replace(
            self,
            beliefs=_joined(beliefs, np.vstack([probed, recent])),
            before=np.concatenate([right * step.error, step.command]),
            suspicion=suspicion,
            wrong_measurements=(yes, no),
            recent=recent,
            alarm=alarm,
        )

    @property
    def probes(self) -> Array:
        """Points of the range of use at which beliefs are compared; shape (`PROBES`, d) [half ranges]."""
        return np.random.default_rng(1).uniform(-0.8, 0.8, (PROBES, self.features.inputs))


class _Elsewhere(NamedTuple):
    """A step from where the one before was predicted to end: how probable that is, features, error, its variance."""

    probability: float
    features: Array
    error: Array
    variance: Array


class _Judged(NamedTuple):
    """Beliefs after a step, and the probabilities that it was wrong, and that it began elsewhere."""

    beliefs: list[Belief]
    wrong: float
    elsewhere: float


def _judged(
    beliefs: Sequence[Belief], best: Belief, features: Array, error: Array, elsewhere: _Elsewhere | None
) -> _Judged:
    """Weighs the beliefs by the density that each gives to an error, and lets each learn the step."""
    predictions = [belief.weights.predicted(features) for belief in beliefs]
    totals = [belief.noise + prediction.variance for belief, prediction in zip(beliefs, predictions, strict=True)]
    # A wrong step is as wide as the widest belief at least: otherwise every large error would be a change.
    wide = np.maximum(np.max(totals, axis=0), WRONG_WIDTH**2 * best.noise)
    doubt = elsewhere.probability if elsewhere else 0.0
    updated = list[Belief]()
    wrongs = list[float]()
    moved = list[float]()
    for belief, (mean, _), total in zip(beliefs, predictions, totals, strict=True):
        # The density of the error by each explanation, in logarithms.
        regular = log(max(1 - WRONG - doubt, 1e-9)) + belief.log_density(error - mean, total)
        wrong = log(WRONG) + log_student(error - mean, wide, WRONG_FREEDOM)
        after = _log_density_elsewhere(belief, elsewhere) if elsewhere else -inf
        density = float(np.logaddexp(np.logaddexp(regular, wrong), after))
        # It is learned by the more probable of the two that explain it, as far as it was not wrong.
        # However large an error is, it counts no more than one as wide as those of wrong steps.
        far = max(1.0, float(np.max((error - mean) ** 2 / wide)))
        trust = max(LEAST_TRUST / far, exp(max(regular, after) - density))
        lesson = (elsewhere.features, elsewhere.error) if elsewhere and after > regular else (features, error)
        learned = belief if belief.kind == "earlier" else belief.learned(*lesson, trust)
        updated.append(replace(learned, log_weight=belief.log_weight + density))
        wrongs.append(exp(wrong - density))
        moved.append(exp(after - density))
    shares = _shares(np.array([belief.log_weight for belief in updated]))
    return _Judged(updated, float(shares @ wrongs), float(shares @ moved))


def _shares(log_weights: Array) -> Array:
    """Probabilities from their logarithms up to a number that all share."""
    shares = np.exp(log_weights - log_weights.max())
    return shares / shares.sum()


def _log_density_elsewhere(belief: Belief, elsewhere: _Elsewhere) -> float:
    """Logarithm of the density of a step's error if it began elsewhere."""
    mean, variance = belief.weights.predicted(elsewhere.features)
    total = variance + belief.noise + elsewhere.variance
    return log(elsewhere.probability + 1e-12) + belief.log_density(elsewhere.error - mean, total)


def _reported(beliefs: Sequence[Belief], settled: Belief) -> tuple[list[Belief], Kind | None]:
    """The beliefs after a change, if there was one, and its kind if it is reported.

    Args:
        beliefs: After a step.
        settled: The most probable one before it that is neither newborn nor what was believed earlier.
    """
    top = max(belief.log_weight for belief in beliefs)
    weighed = [replace(belief, log_weight=belief.log_weight - top) for belief in beliefs]
    first = max(weighed, key=lambda belief: belief.log_weight)
    others = [belief.log_weight for belief in weighed if belief.kind not in ("changed", "earlier")]
    if first.kind not in ("changed", "earlier") or first.log_weight <= log(REPORTED_ODDS) + max(others, default=-inf):
        return weighed, None
    alarm = first.kind if first.kind == "earlier" or first.age <= SUDDEN else None
    if alarm:
        before = replace(settled, kind="earlier", log_weight=log(RETURN_HAZARD))
        weighed = [belief for belief in weighed if belief.kind not in ("current", "earlier") or belief is first]
        weighed = [*weighed, before]
    return [replace(belief, kind="current") if belief is first else belief for belief in weighed], alarm


def _joined(beliefs: Sequence[Belief], probes: Array) -> tuple[Belief, ...]:
    """The beliefs, from the most probable on, of which those that predict the same are one, and few are kept."""
    kept = list[tuple[Belief, Predicted]]()
    for belief in sorted(beliefs, key=lambda one: -one.log_weight):
        mean, variance = belief.weights.predicted(probes)
        prediction = Predicted(mean, variance + belief.noise)
        same = next((row for row, (other, there) in enumerate(kept) if _agree(belief, prediction, other, there)), None)
        if same is not None:
            other, there = kept[same]
            kept[same] = replace(other, log_weight=float(np.logaddexp(other.log_weight, belief.log_weight))), there
        elif len(kept) < MOST or belief.age <= YOUNG or belief.kind == "earlier":
            kept.append((belief, prediction))
    return tuple(belief for belief, _ in kept)


def _agree(one: Belief, of_one: Predicted, other: Belief, of_other: Predicted) -> bool:
    """Whether two beliefs predict the same; what was believed earlier stays apart, and so do the rates of one kind."""
    if "earlier" in (one.kind, other.kind) or (one.kind == other.kind and one.rate != other.rate):
        return False
    near = np.abs(of_one.mean - of_other.mean) < SAME_MEAN * np.sqrt(of_other.variance)
    alike = np.abs(np.log(of_one.variance / of_other.variance)) < SAME_SPREAD
    return bool(near.all() and alike.all())
