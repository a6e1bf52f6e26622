"""The state of learning at every step: what is believed of the robot's error, on top of a fitted residual if wanted."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import nan
from typing import Final, Self, final

import numpy as np
from numpy.typing import NDArray

from stepgap.learning.alarm import Alarm
from stepgap.learning.beliefs import Beliefs, Observed
from stepgap.learning.believed import believed, believed_after, observed, planning_map
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.entry_points import load_residual_model
from stepgap.learning.first_beliefs import features_of
from stepgap.learning.observations import context_inputs_of, error_of, next_history, observe
from stepgap.learning.posterior import POSTERIOR
from stepgap.learning.prior import Prior
from stepgap.learning.residual import Residual, join_points, no_residual
from stepgap.learning.residual_check import check_prediction
from stepgap.learning.residual_fit import fit_residual
from stepgap.learning.settings import AUTO, LearningSettings
from stepgap.learning.steps import LoggedStep, Steps, runs_before
from stepgap.step import Array, StepMap, StepStatus

NO_FAILURE: Final = (StepStatus.OK, StepStatus.DOUBTFUL)
"""Statuses of steps that a controller need not avoid: a doubtful sensor is not due to the command."""
REFIT_GROWTH = 1.1
"""A residual that learns alone is fitted again when the number of steps has grown by this factor."""


@final
@dataclass(frozen=True, eq=False, repr=False)
class Learner:
    """State of learning between two steps of a deployment; `Learner.start` returns the first one, `after` the next one.

    The same steps give the same learner.

    Attributes:
        nominal: Map of the physics model.
        settings: Which residual model is used, and when it is learned.
        iteration: Number of the deployment.
        known: All steps known.
        residual: The fitted residual about whose remaining error is believed; zero for the residual `posterior`.
        beliefs: What is believed; None where nothing is learned during this deployment but by `residual`.
        history: History of the next step, as `observations` defines it; shape (1 + q,).
        alarms: Of the steps of this deployment.
    """

    nominal: StepMap
    settings: LearningSettings
    iteration: int
    known: Steps
    residual: Residual
    beliefs: Beliefs | None
    history: Array
    alarms: tuple[Alarm, ...] = ()

    def __repr__(self) -> str:
        return f"<Learner of deployment {self.iteration}, with residual '{self.settings.residual}': {self.known!r}>"

    @classmethod
    def start(
        cls, nominal: StepMap, known: Steps, settings: LearningSettings, iteration: int, priors: Sequence[Prior] = ()
    ) -> Self:
        """Returns the learner before a deployment.

        Args:
            known: Steps known before the deployment.
            settings: Which residual model is used, and when it is learned.
            priors: Priors over robots, which compete.

        Raises:
            InputError: There is no residual model of this name, or it cannot be used.
            ResidualError: The model failed, or what it returned is not valid.
        """
        believes = _believes(settings, known, iteration)
        residual = _fitted(nominal, known, settings, believes=believes)
        beliefs = _begun(nominal, known, residual, priors) if believes else None
        return cls.restored(nominal, known, settings, iteration, residual, beliefs)

    @classmethod
    def restored(
        cls,
        nominal: StepMap,
        known: Steps,
        settings: LearningSettings,
        iteration: int,
        residual: Residual,
        beliefs: Beliefs | None,
    ) -> Self:
        """Returns the learner before a deployment of which residual and beliefs are known; the others as of `start`."""
        if beliefs and settings.residual == POSTERIOR.name:
            residual = no_residual(*residual.sizes)  # they say the same
        history = next_history(known, nominal.space, iteration)
        return cls(nominal, settings, iteration, known, residual, beliefs, history)

    def redeployed(self, known: Steps, priors: Sequence[Prior] = ()) -> "Learner":
        """Returns the learner before the next deployment, with all steps known then; the priors are those of `start`.

        A residual is fitted again. Beliefs go on. They begin again, with all steps, where the number of known steps
        gives them other features, or after a deployment some of whose steps proved doubtful.
        """
        iteration = self.iteration + 1
        settings = self.settings
        beliefs = self.beliefs if settings.residual == POSTERIOR.name else None
        same = beliefs is not None and beliefs.features.waves == features_of(beliefs.features.inputs, len(known)).waves
        if beliefs is None or not same or known.of_iteration(self.iteration).doubtful.any():
            return Learner.start(self.nominal, known, settings, iteration, priors)
        return self.restored(self.nominal, known, settings, iteration, self.residual, beliefs.redeployed())

    @property
    def failures(self) -> Array:
        """Points (state, command) of the steps that failed; shape (k, n + m)."""
        failed = ~np.isin(self.known.status, NO_FAILURE)
        return join_points(self.known.state[failed], self.known.requested[failed])

    @property
    def farthest(self) -> Array:
        """Largest distance of a command from the state with its number, in deployments before without a failure.

        If all of them failed, up to the failures; infinite before the first one; shape (m,).
        """
        earlier = self.known.before(self.iteration).completed()
        failed = self.known.iteration[~np.isin(self.known.status, NO_FAILURE)]
        unfailing = earlier.selected(~np.isin(earlier.iteration, failed))
        steps = unfailing if len(unfailing) else earlier
        m = len(self.nominal.space.command)
        return np.abs(steps.requested - steps.state[:, :m]).max(axis=0) if len(steps) else np.full(m, np.inf)

    @property
    def phase(self) -> float:
        """Phase of the periodic context quantity at which the next step starts [rad], NaN if it is unknown."""
        last = self.known.last
        periodic = self.nominal.space.periodic
        if last is None or last.iteration != self.iteration or periodic is None:
            return nan
        return periodic.phase(last.record.context.get(periodic.name, nan))

    @property
    def conditioned_residual(self) -> Residual:
        """The error of the next step as far as it is known, a function of state and command."""
        return self.step_map().residual

    @cached_property
    def learned(self) -> Residual:
        """The error as far as it is known, with the steps from which it was learned, for reports and files."""
        if self.beliefs is None or self.settings.residual != POSTERIOR.name:
            return self.residual
        observations = observe(self.known.planned(), self.nominal)
        return believed(self.residual, self.beliefs.features, self.beliefs.mixture(self.phase), observations)

    def step_map(self) -> CorrectedMap:
        """Returns the map that plans the next step."""
        return self._step_map

    @cached_property
    def _step_map(self) -> CorrectedMap:
        return planning_map(self.nominal, self.residual, self.beliefs, self.phase, self.history)

    def found(self, context: Mapping[str, float]) -> Self:
        """Returns the learner at the touchdown of the next step, with the context inputs that it has found."""
        inputs = context_inputs_of(context, self.nominal.space)
        if not len(inputs):
            return self
        return replace(self, history=np.append(self.history[: -len(inputs)], inputs))

    def after(self, logged: LoggedStep) -> "Learner":
        """Returns the learner after the step just executed.

        Raises:
            ResidualError: The residual has no finite prediction of this step.
        """
        return self.found(logged.record.context)._after(logged)

    def _after(self, logged: LoggedStep) -> "Learner":
        record = logged.record
        steps = self.known + [logged]  # noqa: RUF005 they share memory
        error = error_of(record, self.nominal)
        learner = replace(self, known=steps, history=next_history(steps, self.nominal.space, self.iteration))
        known_error = bool(np.isfinite(error).all())
        residual = self.residual.conditioned_on(self.history)
        if known_error and residual.kind != "none":
            point = join_points(record.state, record.requested)
            check_prediction(residual.kind, residual.mean(point), residual.std(point))
        if self.beliefs is None:
            learns = known_error and self.settings.online
            return learner._fitted_on(self.history, error) if learns else learner
        beliefs, _ = believed_after(
            self.beliefs, self.nominal, residual, record, error, self.phase, planned=logged.planned
        )
        alarms = [Alarm(logged.step, beliefs.alarm)] if beliefs.alarm else []
        return replace(learner, beliefs=beliefs, alarms=(*self.alarms, *alarms))

    def _fitted_on(self, history: Array, error: Array) -> "Learner":
        """Learns the latest step by the residual: it is fitted again as soon as enough steps are new.

        Args:
            history: History of that step.
            error: Error of the nominal map at it; shape (n,).
        """
        if self.settings.residual in ("none", POSTERIOR.name):
            return self
        count = len(self.residual.regressions[0].points)
        if len(self.known) > REFIT_GROWTH * count:
            return replace(self, residual=_fitted(self.nominal, self.known, self.settings, believes=False))
        last = self.known.rows[-1]
        residual = self.residual.conditioned_on(history).append(join_points(last["state"], last["requested"]), error)
        return replace(self, residual=residual)


def _believes(settings: LearningSettings, known: Steps, iteration: int) -> bool:
    """Whether beliefs plan a deployment; number 0 is the nominal map's, unless something is learned before or in it."""
    begins = iteration > 0 or settings.learns_in(iteration) or len(known) > 0
    return settings.residual != "none" and settings.drift and begins


def _fitted(nominal: StepMap, known: Steps, settings: LearningSettings, *, believes: bool) -> Residual:
    """The residual of the settings, fitted to all steps known; zero where beliefs are all that is learned.

    The first step of a plant, such as a hop from rest, is not quite like others, and is left out.
    """
    if believes and settings.residual == POSTERIOR.name:
        return no_residual(len(nominal.space.state), len(nominal.space.command))
    observations = observe(known.planned(), nominal)
    name = settings.residual if len(observations) else "none"
    if name != settings.residual != AUTO:
        load_residual_model(settings.residual)  # if it cannot be loaded, no robot moves
    return fit_residual(name, observations, settings.forgetting_time)


def _begun(nominal: StepMap, known: Steps, residual: Residual, priors: Sequence[Prior]) -> Beliefs:
    """The beliefs before a deployment: about what a fitted residual leaves, or about all steps known."""
    space = nominal.space
    n = len(space.state)
    m = len(space.command)
    context = len(space.context_inputs)
    features = features_of(n + m + context, len(known))
    if residual.kind != "none":
        return Beliefs.start(features, (n, m), (), residual.noise_std / space.state_scale, space.is_lagged)
    families = [prior.family(space, features) for prior in priors]
    beliefs = Beliefs.start(features, (n, m), families, None, space.is_lagged)
    doubtful = known.doubtful  # a doubt reaches back into earlier deployments
    of_runs = [np.isin(known.iteration, run) for run in runs_before(known)]
    runs = [list(_observed_in(known.selected(rows), doubtful[rows], nominal)) for rows in of_runs]
    if any(runs):
        beliefs = beliefs.with_runs([run for run in runs if run])
    for iteration in (number for number in known.iterations if number >= 0):
        rows = known.iteration == iteration
        for step, follows in _observed_in(known.selected(rows), doubtful[rows], nominal):
            beliefs = (beliefs if follows else beliefs.unlinked()).after(step)
        beliefs = beliefs.redeployed()
    return beliefs


def _observed_in(steps: Steps, doubtful: NDArray[np.bool_], nominal: StepMap) -> Iterator[tuple[Observed, bool]]:
    """The steps of one or more deployments that have an error and no doubtful state; whether each follows the last."""
    phases = steps.phase
    follows = steps.follows
    last = -1
    for row, logged in enumerate(steps):
        error = error_of(logged.record, nominal)
        if logged.planned and np.isfinite(error).all() and not doubtful[row]:
            step = observed(logged.record, nominal, error, phases[row])
            if step is not None:
                yield step, bool(follows[row]) and last == row - 1
                last = row
