"""Which map is trusted at a step: the corrected one, that with a new disturbance, an earlier one, or the nominal map.

It is decided by likelihood, step by step, as in multiple-model estimation (Blom and Bar-Shalom, The interacting
multiple model algorithm, 1988). The *hypotheses* are

- `current`: residual and disturbance are right;
- `changed`: the robot changed just before one of the latest steps, so that the disturbance began anew there, with a
  wide prior;
- `earlier`: the disturbance is again the one from before the last change;
- `nominal`: the nominal map predicts better than any correction.

The weight of a hypothesis is its posterior probability. From one step to the next the robot may change with a
probability of `HAZARD`, so no weight falls below that, and what was improbable for a long time is believed again after
one or two steps. At the first step of a deployment the robot may be another one, with a probability of `FIRST_HAZARD`.

A hypothesis predicts an error with a normal distribution, or, with a probability of `OUTLIER_PROBABILITY`, with one
that is `OUTLIER_WIDTH` times as wide in all coordinates, since a push, a slip or a wrong measurement disturbs a step as
a whole. So one large error is an outlier, two of the same kind are a change.
"""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, Self, final

import numpy as np

from stepgap.base.normal import log_density
from stepgap.learning.disturbance import Disturbance, DisturbanceFilter
from stepgap.learning.outliers import LEAST_KNOWN, LEAST_STD, OUTLIER_PROBABILITY, OUTLIER_WIDTH, improbable_errors
from stepgap.learning.residual import Residual
from stepgap.step import Array

Source = Literal["current", "changed", "earlier", "nominal"]
"""What a hypothesis takes the next state from; the module describes each."""

HAZARD = 1e-3
"""Probability that the robot changes from one step to the next."""
FIRST_HAZARD = 0.1
"""Probability that the robot is another one than in the deployments that were learned from."""
SWITCHING_ODDS = 3.0
"""Another hypothesis is trusted from these odds in its favour on, so that two equally good ones do not alternate."""
MOST_STRAINED = 2
"""After this number of improbable steps at a bound of the command, the nominal map chooses commands until the corrected
map predicts again: a robot that does not follow is not pushed any longer."""
CANDIDATES = 2
"""Number of steps kept at which the disturbance may have begun anew, and of earlier disturbances."""
NOMINAL_MEMORY = 0.9
"""Factor by which the error of the nominal map at a step counts less at the next one, in the size of these errors."""
NOMINAL_COUNT = 4.0
"""Number of steps for which the size of the nominal map's errors at the known steps counts."""


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


@final
@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One hypothesis.

    Attributes:
        source: What it takes the next state from.
        filter: Its disturbance; of no use to `nominal`.
        log_weight: Logarithm of its probability.
    """

    source: Source
    filter: DisturbanceFilter
    log_weight: float


@final
@dataclass(frozen=True, eq=False)
class Trust:
    """The hypotheses between two steps of a deployment; immutable. `start` returns the first one, `after` the next one.

    Attributes:
        state_scale: Half the range of use of each state coordinate; shape (n,).
        drift: Whether the disturbance is estimated where there is a correction; otherwise it is zero.
        monitor: Whether the nominal map may be trusted more than the corrected one.
        reject_outliers: Whether single steps with improbable errors are outliers.
        hypotheses: The first one is `current`.
        nominal_squares: Mean square of the nominal map's errors at the latest steps, and how many that are; shape (n,).
        nominal_count: See above.
        nominal: Whether the nominal map is trusted.
        strained: Number of the latest steps, one after the other, with errors improbable by the corrected map and a
            command at its bound.
        outlier: Whether the latest step was an outlier: improbable by the hypothesis that is trusted now.
        alarm: What is trusted since the latest step, if that has changed with it.
    """

    state_scale: Array
    drift: bool
    monitor: bool
    reject_outliers: bool
    hypotheses: tuple[Hypothesis, ...]
    nominal_squares: Array
    nominal_count: float = NOMINAL_COUNT
    nominal: bool = False
    strained: int = 0
    outlier: bool = False
    alarm: Source | None = None

    @classmethod
    def start(
        cls, state_scale: Array, residual: Residual, *, drift: bool, monitor: bool, reject_outliers: bool
    ) -> Self:
        """Returns the hypotheses before the first step; the other arguments are those of `Trust`.

        Args:
            state_scale: See `Trust`.
            residual: The residual before the deployment.
        """
        values = [np.asarray(regression.values, float) for regression in residual.regressions]
        squares = np.array([np.mean(each**2) if len(each) else 0.0 for each in values])
        initial = DisturbanceFilter.initial(len(state_scale), sum(residual.sizes))
        current = Hypothesis("current", initial, 0.0)
        trust = cls(state_scale, drift, monitor, reject_outliers, (current,), squares)
        return replace(trust, hypotheses=trust._before_a_step(residual, FIRST_HAZARD))

    def restarted(self, residual: Residual) -> "Trust":
        """Returns the hypotheses about another residual."""
        drift, monitor, reject_outliers = self.drift, self.monitor, self.reject_outliers
        return Trust.start(self.state_scale, residual, drift=drift, monitor=monitor, reject_outliers=reject_outliers)

    @property
    def uses_nominal(self) -> bool:
        """Whether the next step is planned with the nominal map."""
        return self.nominal or self.strained >= MOST_STRAINED

    @property
    def trusted(self) -> Hypothesis:
        """The hypothesis whose map is used: `current`, or `nominal`."""
        return self.hypotheses[-1 if self.nominal else 0]

    def predict(self, residual: Residual, phase: float) -> Disturbance:
        """The disturbance of the next step, of the residual that it is added to.

        Args:
            residual: The residual.
            phase: Phase at which the step starts [rad], NaN if it is unknown.
        """
        return self.hypotheses[0].filter.predict(phase, residual.noise_std)

    def change(self, step: PredictedStep) -> Array:
        """By what the robot has changed at a step since the residual was learned; shape (n,) [units of the state]."""
        current = self.hypotheses[0].filter
        return current.predict(step.phase).mean(step.inputs) if current.changed else np.zeros_like(step.error)

    def after(self, residual: Residual, step: PredictedStep, *, at_bound: bool) -> "Trust":
        """Returns the hypotheses after a step.

        Args:
            residual: The residual that predicted it.
            step: The step.
            at_bound: Whether a command was at its bound.
        """
        judges, judged = len(residual.regressions[0].points) >= LEAST_KNOWN, []
        for each in self._before_a_step(residual, HAZARD) if judges else self.hypotheses:
            innovation, total = self._innovation(each, residual, step)
            improbable = judges and self.reject_outliers and bool(improbable_errors(innovation, total).any())
            likely = self._log_likelihood(innovation, total) if judges else 0.0
            learns = self.drift and residual.kind != "none" and each.source in ("current", "changed") and not improbable
            found = each.filter
            if learns:
                found = found.updated(step.error - step.mean, step.phase, step.std, step.inputs)
            judged.append((Hypothesis(each.source, found, each.log_weight + likely), improbable))
        surprised = judged[0][1]
        strained = self.strained + (at_bound or self.strained >= MOST_STRAINED) if surprised else 0
        memory = NOMINAL_MEMORY * self.nominal_count
        squares = (memory * self.nominal_squares + step.error**2) / (memory + 1)
        return self._settled(judged, nominal_squares=squares, nominal_count=memory + 1, strained=strained)

    def _before_a_step(self, residual: Residual, hazard: float) -> tuple[Hypothesis, ...]:
        """The hypotheses before a step: none is less probable than a change is, and the disturbance may begin anew."""
        least, anew = float(np.log(hazard)), self.hypotheses[0].filter.restarted()
        kept = [replace(each, log_weight=max(each.log_weight, least)) for each in self.hypotheses]
        if residual.kind == "none":
            return tuple(kept)
        if self.monitor and all(each.source != "nominal" for each in kept):
            kept.append(Hypothesis("nominal", anew, least))
        return (*kept, Hypothesis("changed", anew, least)) if self.drift else tuple(kept)

    def _innovation(self, hypothesis: Hypothesis, residual: Residual, step: PredictedStep) -> tuple[Array, Array]:
        """Error of a hypothesis' prediction, and the standard deviation of that; shapes (n,) [half ranges]."""
        if hypothesis.source == "nominal":
            error, std = step.error, np.maximum(np.sqrt(self.nominal_squares), step.std)
        else:
            disturbance = hypothesis.filter.predict(step.phase, residual.noise_std)
            error = step.error - step.mean - disturbance.mean(step.inputs)
            std = np.hypot(step.std, disturbance.std(step.inputs))
        return error / self.state_scale, np.maximum(std / self.state_scale, LEAST_STD)

    def _settled(self, judged: list[tuple[Hypothesis, bool]], **changes: object) -> "Trust":
        """Keeps the probable hypotheses; that of a change becomes the current one where it is trusted."""
        total = float(np.logaddexp.reduce([each.log_weight for each, _ in judged]))
        judged = [(replace(each, log_weight=each.log_weight - total), improbable) for each, improbable in judged]
        trusted = next(pair for pair in judged if pair[0].source == self.trusted.source)
        best, improbable = max(judged, key=lambda pair: pair[0].log_weight)
        if best.log_weight < trusted[0].log_weight + np.log(SWITCHING_ODDS):
            best, improbable = trusted
        ordered = sorted((each for each, _ in judged[1:]), key=lambda each: -each.log_weight)
        groups = {name: [each for each in ordered if each.source == name] for name in ("changed", "earlier", "nominal")}
        current = judged[0][0]
        if best.source in ("changed", "earlier"):
            before = replace(current, source="earlier")
            groups["earlier"] = [before, *(each for each in groups["earlier"] if each is not best)]
            groups["changed"], current = [], replace(best, source="current")
        kept = [each for group in groups.values() for each in group[:CANDIDATES]]
        alarm = None if best.source == self.trusted.source else best.source
        known = {"outlier": improbable, "alarm": alarm, "nominal": best.source == "nominal"}
        return replace(self, hypotheses=(current, *kept), **known, **changes)  # pyright: ignore[reportArgumentType]

    def _log_likelihood(self, innovation: Array, std: Array) -> float:
        """Logarithm of the density of an error, which may be that of an outlier; shapes (n,) [half ranges]."""
        regular = float(np.sum(log_density(innovation, std)))
        if not self.reject_outliers:
            return regular
        outlier = float(np.sum(log_density(innovation, OUTLIER_WIDTH * std)))
        return float(np.logaddexp(regular + np.log1p(-OUTLIER_PROBABILITY), outlier + np.log(OUTLIER_PROBABILITY)))
