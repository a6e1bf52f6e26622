"""Which map is trusted at a step: the corrected one, that with a new disturbance, an earlier one, or the nominal map.

It is decided by likelihood, step by step, as in multiple-model estimation (Blom and Bar-Shalom, The interacting
multiple model algorithm, 1988). The *hypotheses* are

- `current`: the map and the disturbance that planned the latest step are right;
- `changed`: the robot changed just before one of the latest steps; since then the corrected map has a new disturbance,
  with a wide prior;
- `nominal`: the residual is wrong; since one of the latest steps the nominal map has such a new disturbance instead;
- `earlier`: map and disturbance are again those from before an alarm.

The weight of a hypothesis is its posterior probability. From one step to the next the robot may change with a
probability in `HAZARDS`, so no weight falls below that, and what was improbable for a long time is believed again after
one or two steps. At the first step of a deployment the robot may be another one, with a probability in `FIRST_HAZARDS`,
or in `WARM_HAZARDS` after a warm start, whose steps may be of a quite different robot.

A hypothesis predicts an error with a normal distribution, or, with a probability of `OUTLIER_PROBABILITY`, with one
that is `OUTLIER_WIDTH` times as wide in all coordinates, or as wide as a change, since a push, a slip or a wrong
measurement disturbs a step as a whole. So one large error is an outlier, two of the same kind are a change.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, log, log1p
from typing import Literal, NamedTuple, Self, final

import numpy as np

from stepgap.base.normal import log_density
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.disturbance import Disturbance, DisturbanceFilter
from stepgap.learning.outliers import LEAST_STD, OUTLIER_PROBABILITY, OUTLIER_WIDTH, improbable_errors
from stepgap.learning.residual import Residual, join_points, no_residual
from stepgap.step import Array, StepMap, StepRecord, StepSpace

MapSource = Literal["current", "changed", "nominal", "earlier"]
"""What a hypothesis takes the next state from; the module describes each."""

HAZARDS = {"changed": 1e-3, "earlier": 1e-3, "nominal": 1e-9}
"""Probability of each kind of change from one step to the next. A linear disturbance of the nominal map soon predicts
steps at one target as well as a residual does, which knows more; so it must be needed for several steps."""
FIRST_HAZARDS = {"changed": 0.05, "nominal": 1e-9}
"""Probability that the robot is another one than in the deployments of the run that were learned from."""
WARM_HAZARDS = {"changed": 0.3, "nominal": 0.3}
"""The same, if steps of earlier runs were learned from."""
SWITCHING_ODDS = 10.0
"""Another hypothesis is trusted from these odds in its favour on, so that two equally good ones do not alternate."""
STRAINING = 0.9
"""A command strains the robot beyond this part of its half range."""
MOST_STRAINED = 2
"""After this number of unexplained steps at a bound of the command, the nominal map chooses commands until a prediction
is right: a robot that does not follow is not pushed any longer."""
LEAST_ERROR, LARGEST_DEVIATION = 0.25, 0.5
"""A step is unexplained if its error was improbable and larger than the first, or if the standard deviation of its
prediction, without noise, was larger than the second, so that it said next to nothing [half ranges]."""
YOUNG = 10
"""A disturbance that began fewer steps ago explains anything: whether a step is improbable is judged without it."""
CANDIDATES = 2
"""Number of hypotheses of each kind that are kept beside the current one."""


def first_hazards(*, warm_start: bool) -> Mapping[str, float]:
    """Probability of each kind of change before the first step, with or without steps from before the run."""
    return WARM_HAZARDS if warm_start else FIRST_HAZARDS


class PredictedStep(NamedTuple):
    """A step with the prediction of a residual.

    Attributes:
        inputs: State and requested command from the middle of their ranges on; shape (n + m,) [half ranges].
        error: Error of the nominal map; shape (n,) [units of the state].
        mean: Prediction of that error; shape (n,) [units of the state].
        std: Standard deviation of this prediction, with noise; shape (n,) [units of the state].
        phase: Phase at which the step started [rad], NaN if it is unknown.
    """

    inputs: Array
    error: Array
    mean: Array
    std: Array
    phase: float


def predicted_step(
    residual: Residual, record: StepRecord, space: StepSpace, error: Array, phase: float
) -> PredictedStep:
    """A step as a residual predicts it.

    Args:
        residual: Conditioned on the history of the step.
        record: The step.
        space: Step space of both.
        error: Error of the nominal map at it; shape (n,).
        phase: Phase at which it started [rad], NaN if it is unknown.
    """
    point = join_points(record.state, record.requested)
    mean, std = residual.mean(point), residual.std(point, include_noise=True)
    inputs = space.scaled_inputs(record.state, record.requested)
    return PredictedStep(inputs=inputs, error=error, mean=mean, std=std, phase=phase)


class Alarm(NamedTuple):
    """Another hypothesis is trusted.

    Attributes:
        step: Number of the step that brought this about.
        source: What is trusted now; never `current`. `other_robot`: other earlier runs are of this robot
            than it seemed.
    """

    step: int
    source: MapSource | Literal["other_robot"]


@final
@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One hypothesis.

    Attributes:
        source: Which kind it is.
        filter: Its disturbance.
        log_weight: Logarithm of its probability.
        corrected: Whether it uses the residual.
        age: Number of steps since its disturbance began.
    """

    source: MapSource
    filter: DisturbanceFilter
    log_weight: float
    corrected: bool = True
    age: int = 0


@final
@dataclass(frozen=True, eq=False)
class Trust:
    """The hypotheses between two steps of a deployment; immutable. `start` returns the first one, `after` the next one.

    Attributes:
        state_scale: Half the range of use of each state coordinate; shape (n,).
        drift: Whether the disturbance is estimated where there is a correction; otherwise it is zero.
        monitor: Whether the nominal map may be trusted more than the corrected one, or plan in its place.
        reject_outliers: Whether single steps with improbable errors are outliers.
        hypotheses: The first one is `current`.
        strained: Number of the latest steps, one after the other, that were unexplained, with a straining command.
        outlier: Whether the latest step was an outlier: improbable by the hypothesis that is trusted now.
        alarm: What is trusted since the latest step, if that has changed with it.
    """

    state_scale: Array
    drift: bool
    monitor: bool
    reject_outliers: bool
    hypotheses: tuple[Hypothesis, ...]
    strained: int = 0
    outlier: bool = False
    alarm: MapSource | None = None

    @classmethod
    def start(
        cls,
        state_scale: Array,
        residual: Residual,
        *,
        drift: bool,
        monitor: bool,
        reject_outliers: bool,
        warm_start: bool = False,
    ) -> Self:
        """Returns the hypotheses before the first step; the other arguments are those of `Trust`.

        Args:
            state_scale: See `Trust`.
            residual: The residual before the deployment.
            warm_start: Whether steps from before this run were learned from.
        """
        current = Hypothesis(
            "current", DisturbanceFilter.initial(len(state_scale), sum(residual.sizes)), 0.0, age=YOUNG
        )
        trust = cls(state_scale, drift, monitor, reject_outliers, (current,))
        return replace(trust, hypotheses=trust._before_a_step(residual, first_hazards(warm_start=warm_start)))

    @property
    def uses_residual(self) -> bool:
        """Whether the next step is planned with the residual."""
        return self.hypotheses[0].corrected and self.strained < MOST_STRAINED

    def predict(self, residual: Residual, phase: float) -> Disturbance:
        """The disturbance of the next step, of the map that it is added to.

        Args:
            residual: The residual, from which its standard deviation follows.
            phase: Phase at which the step starts [rad], NaN if it is unknown.
        """
        disturbance = self.hypotheses[0].filter.predict(phase, residual.noise_std)
        return disturbance if self.strained < MOST_STRAINED else disturbance.removed()

    def step_map(self, nominal: StepMap, residual: Residual, phase: float) -> CorrectedMap:
        """The map that plans the next step.

        Args:
            nominal: The nominal map.
            residual: As for `predict`, conditioned on the history of the step.
            phase: As for `predict`.
        """
        used = residual if self.uses_residual else no_residual(*residual.sizes)
        disturbance = self.predict(residual, phase)
        return CorrectedMap(nominal, used, None if disturbance.is_zero else disturbance)

    def change(self, step: PredictedStep) -> Array:
        """By what the robot has changed at a step since the residual was learned; shape (n,) [units of the state]."""
        current = self.hypotheses[0]
        if not (current.corrected and current.filter.changed):
            return np.zeros_like(step.error)
        return current.filter.predict(step.phase).mean(step.inputs)

    def after(self, residual: Residual, step: PredictedStep) -> "Trust":
        """Returns the hypotheses after a step that this residual predicted."""
        judges, judged = residual.is_known, []
        hypotheses = self._before_a_step(residual, HAZARDS) if judges else self.hypotheses
        predictions = [self._innovation(each, residual, step) for each in hypotheses]
        outlier = self._outlier_density(predictions)
        for each, (innovation, total) in zip(hypotheses, predictions, strict=True):
            improbable = judges and self.reject_outliers and bool(improbable_errors(innovation, total).any())
            likely = _log_likelihood(innovation, total, outlier) if judges else 0.0
            learns = self.drift and residual.kind != "none" and each.source != "earlier" and not improbable
            disturbance = each.filter
            if learns:
                remaining = step.error - step.mean if each.corrected else step.error
                disturbance = disturbance.updated(remaining, step.phase, step.std, step.inputs)
            found = replace(each, filter=disturbance, log_weight=each.log_weight + likely, age=each.age + 1)
            judged.append((found, improbable))
        unexplained = judges and self.monitor and self._is_unexplained(residual, step, *predictions[0])
        return self._settled(judged, self._strained(step) if unexplained else 0)

    def _is_unexplained(self, residual: Residual, step: PredictedStep, error: Array, std: Array) -> bool:
        """Whether the current hypothesis, with this error and standard deviation, does not explain a step; (n,)."""
        unsure = bool((std > np.hypot(LARGEST_DEVIATION, residual.noise_std / self.state_scale)).any())
        if self.hypotheses[0].age < YOUNG:
            error, std = (step.error - step.mean) / self.state_scale, step.std / self.state_scale
        return unsure or bool((np.abs(error[improbable_errors(error, std) != 0]) > LEAST_ERROR).any())

    def _strained(self, step: PredictedStep) -> int:
        """`strained` after an unexplained step."""
        strains = (np.abs(step.inputs[len(step.error) :]) > STRAINING).any() or self.strained >= MOST_STRAINED
        return self.strained + int(strains)

    def _before_a_step(self, residual: Residual, hazards: Mapping[str, float]) -> tuple[Hypothesis, ...]:
        """The hypotheses before a step: none is less probable than a change is, and a new disturbance may begin."""
        least, current = {source: log(hazard) for source, hazard in hazards.items()}, self.hypotheses[0]
        others = [replace(each, log_weight=max(each.log_weight, least[each.source])) for each in self.hypotheses[1:]]
        if residual.kind == "none":
            return (current, *others)
        initial = DisturbanceFilter.initial(len(self.state_scale), len(current.filter.prior[0]) - 3)
        changed = (current.filter if current.corrected else initial).restarted()
        born = [Hypothesis("changed", changed, least["changed"])] if self.drift else []
        born += [Hypothesis("nominal", initial.restarted(), least["nominal"], corrected=False)] if self.monitor else []
        return (current, *others, *born)

    def _innovation(self, hypothesis: Hypothesis, residual: Residual, step: PredictedStep) -> tuple[Array, Array]:
        """Error of a hypothesis' prediction, and the standard deviation of that; shapes (n,) [half ranges]."""
        disturbance = hypothesis.filter.predict(step.phase, residual.noise_std)
        mean = step.mean if hypothesis.corrected else 0.0
        total = np.hypot(step.std, disturbance.std(step.inputs)) / self.state_scale
        return (step.error - mean - disturbance.mean(step.inputs)) / self.state_scale, np.maximum(total, LEAST_STD)

    def _settled(self, judged: list[tuple[Hypothesis, bool]], strained: int) -> "Trust":
        """Keeps the probable hypotheses; the one that is trusted is the current one, and that before is kept, too."""
        total = float(np.logaddexp.reduce([each.log_weight for each, _ in judged]))
        judged = [(replace(each, log_weight=each.log_weight - total), improbable) for each, improbable in judged]
        (current, improbable), alarm = judged[0], None
        others = sorted((each for each, _ in judged[1:]), key=lambda each: -each.log_weight)
        best, best_improbable = max(judged, key=lambda pair: pair[0].log_weight)
        if best.log_weight > current.log_weight + log(SWITCHING_ODDS):
            before = replace(current, source="earlier")
            others = [before, *(each for each in others if each is not best and each.source == "earlier")]
            current, improbable, alarm = replace(best, source="current"), best_improbable, best.source
        groups = [[each for each in others if each.source == source] for source in ("changed", "nominal", "earlier")]
        kept = [each for group in groups for each in group[:CANDIDATES]]
        return replace(self, hypotheses=(current, *kept), strained=strained, outlier=improbable, alarm=alarm)

    def _outlier_density(self, predictions: Sequence[tuple[Array, Array]]) -> float:
        """Logarithm of the density of an outlier's error, the same by all hypotheses; −inf where there are none.

        It is as wide as the widest hypothesis: otherwise a very large error would be a change. The same, since far out
        the densities of hypotheses differ by much that means nothing.
        """
        if not self.reject_outliers:
            return -inf
        widest = np.max([OUTLIER_WIDTH * predictions[0][1], *(std for _, std in predictions)], axis=0)
        return max(float(np.sum(log_density(innovation, widest))) for innovation, _ in predictions)


def _log_likelihood(innovation: Array, std: Array, outlier: float) -> float:
    """Logarithm of the density of an error (n,) [half ranges], which may be that of an outlier."""
    regular = float(np.sum(log_density(innovation, std)))
    return float(np.logaddexp(regular + log1p(-OUTLIER_PROBABILITY), outlier + log(OUTLIER_PROBABILITY)))
