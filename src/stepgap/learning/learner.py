"""The state of learning at every step: a residual fitted to a log, trusted or not, and updated online if wanted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan
from typing import Self, final

import numpy as np

from stepgap.learning.background import Deferred
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.earlier_runs import EarlierRuns
from stepgap.learning.observations import context_inputs_of, error_of, history_after, next_history, observe
from stepgap.learning.outliers import LEAST_KNOWN, improbable_errors
from stepgap.learning.prior import Prior
from stepgap.learning.residual import Residual, join_points
from stepgap.learning.residual_check import check_prediction
from stepgap.learning.residual_fit import explains_better, learned_residual
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.learning.trust import Alarm, Trust, predicted_step
from stepgap.learning.zero import NONE
from stepgap.step import Array, StepMap, StepRecord, StepStatus

REFIT_GROWTH = 1.1
"""A new fit begins when the number of steps has grown by this factor."""
FIRST_STEPS = 2
"""A first fit, to at most this number of steps, takes no time, so that it is used at once."""
FITTED_PER_STEP = 150
"""Number of known steps for which a fit is given the time of one step of the robot; a slower fit is waited for."""
_NO_FAILURE = (StepStatus.OK, StepStatus.DOUBTFUL)
"""Statuses of steps that a controller need not avoid: a doubtful sensor is not due to the command."""


@final
@dataclass(frozen=True, eq=False)
class Refit:
    """A fit of new hyper-parameters that does not replace the present residual yet.

    Attributes:
        residual: Fitted to the steps known when the fit began, and updated with those since.
        due: Number of known steps at which it replaces the present residual.
    """

    residual: Deferred[Residual]
    due: int


@final
@dataclass(frozen=True, eq=False)
class Learner:
    """State of learning between two steps of a deployment; `Learner.start` returns the first one, `after` the next one.

    `Trust` decides by likelihood which map plans the next step: the corrected one with its disturbance, or the nominal
    one. A learner that learns online updates its residual with every step before the next one is planned, and also
    finds new hyper-parameters: the fit is deferred, so that a `BackgroundThread` can compute `pending` while the robot
    moves, and its result is used from a fixed number of steps later on, by `FITTED_PER_STEP`. So the same steps give
    the same learner, however long a fit takes.

    Attributes:
        nominal: Map of the physics model.
        settings: Which residual model is used, and whether steps of this deployment are learned from.
        iteration: Number of the deployment.
        known: All steps known.
        earlier: The earlier runs among them; None if there are none.
        left_out: Numbers of the deployments of earlier runs that are probably of another robot.
        log: The steps known, without those.
        residual: The fitted residual, which may depend on the history of a step, too.
        history: History of the next step, as `observations` defines it; shape (2n + m + 1 + q,).
        failures: Points (state, command) of the steps that failed; shape (k, n + m).
        learns: Whether the next step is learned from: always online, else until exploration ends.
        trust: Which map is trusted, and the disturbance of the corrected one.
        outliers: Deployment and number of each step of this deployment that was an outlier when it was executed.
        alarms: Of the steps of this deployment.
        changes: Row in the log of each step after a change of the robot, and by what it had changed there; shape (n,).
        refit: The fit that is running, if there is one.
        refit_from: Number of known steps from which the next fit may begin.
        priors: Priors over robots, which compete; none if there are none.
    """

    nominal: StepMap
    settings: LearningSettings
    iteration: int
    known: Steps
    earlier: EarlierRuns | None
    left_out: frozenset[int]
    log: Steps
    residual: Residual
    history: Array
    failures: Array
    learns: bool
    trust: Trust
    outliers: tuple[tuple[int, int], ...]
    alarms: tuple[Alarm, ...]
    changes: tuple[tuple[int, Array], ...]
    refit: Refit | None
    refit_from: float
    priors: Sequence[Prior] = ()

    @classmethod
    def start(
        cls,
        nominal: StepMap,
        known: Steps,
        settings: LearningSettings,
        iteration: int,
        residual: Residual | None = None,
        priors: Sequence[Prior] = (),
    ) -> Self:
        """Returns the learner before a deployment.

        Args:
            nominal: Map of the physics model.
            known: Steps known before the deployment.
            settings: Which residual model is used, and whether steps of this deployment are learned from.
            iteration: Number of the deployment.
            residual: The residual that was fitted to these steps; None to fit it.
            priors: Priors over robots, which compete.
        """
        earlier = EarlierRuns.of(known, nominal, priors) if known.has_earlier_runs else None
        left_out = earlier.of_others(observe(_own(known).planned(), nominal)) if earlier else frozenset[int]()
        log = _without(known, left_out)
        if residual is None:
            residual = _fitted(nominal, log, settings, iteration, None, priors)
        return cls(
            nominal=nominal,
            settings=settings,
            iteration=iteration,
            known=known,
            earlier=earlier,
            left_out=left_out,
            log=log,
            residual=residual,
            history=next_history(log, nominal, iteration),
            failures=_failures_in(log),
            learns=settings.learns_in(iteration),
            trust=_trust(nominal, settings, residual, log),
            outliers=(),
            alarms=(),
            changes=(),
            refit=None,
            refit_from=max(1.0, REFIT_GROWTH * len(log)),
            priors=priors,
        )

    @property
    def conditioned_residual(self) -> Residual:
        """The residual of the next step, a function of state and command."""
        return self.residual.conditioned_on(self.history)

    @property
    def phase(self) -> float:
        """Phase of the periodic context quantity at which the next step starts [rad], NaN if it is unknown."""
        last, periodic = self.log.last, self.log.space.periodic
        if periodic is None or last is None or last.iteration != self.iteration:
            return nan
        return periodic.phase(last.record.context[periodic.name])

    @property
    def pending(self) -> Deferred[Residual] | None:
        """The pending fit, which a thread may compute before it is due."""
        return self.refit and self.refit.residual

    def step_map(self) -> CorrectedMap:
        """Returns the map that plans the next step."""
        return self.trust.step_map(self.nominal, self.conditioned_residual, self.phase)

    def found(self, context: Mapping[str, float]) -> Self:
        """Returns the learner at the touchdown of the next step, with the context inputs that it has found."""
        inputs = context_inputs_of(context, self.nominal.space)
        if not len(inputs):
            return self
        return replace(self, history=np.append(self.history[: -len(inputs)], inputs))

    def after(self, logged: LoggedStep) -> "Learner":
        """Returns the learner after the step just executed.

        Raises:
            ResidualError: The residual has no finite prediction of this step, or a new fit failed.
        """
        return self.found(logged.record.context)._after(logged)._without_other_robots(logged)

    def _without_other_robots(self, logged: LoggedStep) -> "Learner":
        """Begins again where a step shows that other earlier runs are of this robot than it seemed.

        Until a fit to these runs is due, the residual is one that was fitted to this robot's own steps alone.
        """
        if self.earlier is None or not self.learns or len(self.known) - self.earlier.steps > LEAST_KNOWN:
            return self
        own = _own(self.known)
        left_out = self.earlier.of_others(observe(own.planned(), self.nominal), self.left_out)
        if left_out == self.left_out:
            return self
        log = _without(self.known, left_out)
        residual = _fitted(self.nominal, own, self.settings, self.iteration, None, self.priors)
        learner = replace(
            self,
            left_out=left_out,
            log=log,
            residual=residual,
            history=next_history(log, self.nominal, self.iteration),
            failures=_failures_in(log),
            trust=_trust(self.nominal, self.settings, residual, log),
            alarms=(*self.alarms, Alarm(logged.step, "other_robot")),
            changes=(),
            refit=None,
            refit_from=REFIT_GROWTH * len(log) if len(log) == len(own) else 1.0,
        )
        return learner._with_refit()

    def _after(self, logged: LoggedStep) -> "Learner":
        record, log = logged.record, self.log + [logged]  # noqa: RUF005 they share memory
        error, point = error_of(record, self.nominal), _point_of(record)
        failed = record.status not in _NO_FAILURE
        learner = replace(
            self,
            known=log if self.log is self.known else self.known + [logged],  # noqa: RUF005
            log=log,
            history=history_after(record, error, self.nominal.space, len(log)),
            failures=np.vstack([self.failures, point]) if failed else self.failures,
        )
        ends = self.learns and not self.settings.online and logged.step >= 0
        if not np.isfinite(error).all():
            return learner._ended() if ends else learner._with_refit()
        residual = self.conditioned_residual
        step = predicted_step(residual, record, self.nominal.space, error, self.phase)
        check_prediction(residual.kind, step.mean, step.std)
        trust = self.trust.after(residual, step) if logged.planned else self.trust
        change, alarms = trust.change(step), [Alarm(logged.step, trust.alarm)] if trust.alarm else []
        learner = replace(learner, trust=trust, alarms=(*self.alarms, *alarms))
        if change.any():
            learner = replace(learner, changes=(*self.changes, (len(self.log), change)))
        if trust.outlier:
            learner = replace(learner, outliers=(*self.outliers, (logged.iteration, logged.step)))
        if ends:
            return learner._ended()
        if self.learns and not trust.outlier:
            learner = learner._updated(self.history, point, error - change)
        return learner._with_refit()

    def _ended(self) -> "Learner":
        """The learner after the last exploratory step, which has number 0: it learns no more, from all steps known."""
        fitted = _fitted(self.nominal, self._lessons, self.settings, self.iteration, self.residual, self.priors)
        return replace(self, learns=False, residual=fitted, refit=None)

    @property
    def _lessons(self) -> Steps:
        """The steps known, as the robot would have made them before it changed in this deployment."""
        if not self.changes:
            return self.log
        next_state = self.log.next_state
        for row, change in self.changes:
            next_state[row] -= change
        return self.log.with_columns(next_state=next_state)

    def _updated(self, history: Array, point: Array, error: Array) -> "Learner":
        """Learns a step: it updates the present residual or that of a fit that is due."""

        def update(residual: Residual) -> Residual:
            return residual.conditioned_on(history).append(point, error)

        if self.refit is None:
            return replace(self, residual=update(self.residual))
        pending = self.refit.residual.then(update)
        if len(self.log) >= self.refit.due:
            return replace(self, residual=pending.result(), refit=None)
        return replace(self, residual=update(self.residual), refit=Refit(pending, self.refit.due))

    def _with_refit(self) -> "Learner":
        """Begins a new fit if the number of steps has grown enough and no other fit is pending."""
        count = len(self.log)
        if self.refit or not self.learns or count < self.refit_from:
            return self
        known = self.nominal, self._lessons, self.settings, self.iteration, self.residual, self.priors
        due = count + 1 + count // FITTED_PER_STEP
        if self.residual.kind == NONE.name and count <= FIRST_STEPS:
            return replace(self, residual=_fitted(*known), refit_from=due)
        refit = Refit(Deferred(lambda: _fitted(*known)), due)
        return replace(self, refit=refit, refit_from=max(REFIT_GROWTH * count, due + 1))


def _without(known: Steps, left_out: frozenset[int]) -> Steps:
    """The steps without some deployments; the same object if there are none, so that its memory is shared."""
    return known.selected(~np.isin(known.iteration, [*left_out])) if left_out else known


def _failures_in(log: Steps) -> Array:
    """Points (state, command) of the steps that failed; shape (k, n + m)."""
    return join_points(log.state, log.requested)[~np.isin(log.status, _NO_FAILURE)]


def _own(known: Steps) -> Steps:
    """The steps of this run."""
    return known.selected(known.iteration >= 0)


def _trust(nominal: StepMap, settings: LearningSettings, residual: Residual, log: Steps) -> Trust:
    """The hypotheses before the next step, with a residual that was fitted to a log."""
    return Trust.start(
        nominal.space.state_scale,
        residual,
        drift=settings.drift,
        monitor=settings.monitor,
        reject_outliers=settings.reject_outliers,
        warm_start=log.has_earlier_runs,
    )


def _fitted(
    nominal: StepMap,
    log: Steps,
    settings: LearningSettings,
    iteration: int,
    start: Residual | None,
    priors: Sequence[Prior],
) -> Residual:
    """Fits the residual to all known steps, or where these explain the latest deployment worse, to this one alone.

    The search for hyper-parameters starts at those of `start`. The first step of a plant, such as a hop from rest, is
    not quite like others, and is left out as soon as enough of these are known.
    """
    planned = log.planned()
    log = planned if len(planned) >= LEAST_KNOWN else log
    observations = observe(log, nominal)
    residual = learned_residual(observations, settings, iteration, start, priors)
    latest = observations.labels[:, 0] == observations.labels[-1:, 0]
    if residual.kind == "none" or latest.all() or latest.sum() < LEAST_KNOWN or not _is_surprising(log):
        return residual
    alone = learned_residual(observations.selected(latest), settings, iteration, start)
    return alone if explains_better(alone, residual, observations) else residual


def _is_surprising(log: Steps) -> bool:
    """Whether the latest deployment had improbable steps one after the other, or one that the nominal map planned."""
    steps = log.of_iteration(int(log.iteration[-1])).completed()
    error, scale = steps.next_state - steps.predicted, log.space.state_scale
    signs = improbable_errors(np.nan_to_num(error) / scale, steps.std / scale)
    improbable = np.any(signs != 0, axis=1)
    return bool(np.any(improbable[1:] & improbable[:-1]) or np.any(steps.std == 0))


def _point_of(record: StepRecord) -> Array:
    """State and requested command of a step; shape (n + m,)."""
    return join_points(record.state, record.requested)
