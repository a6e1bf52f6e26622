"""What is known of the map's error at every step: a residual fitted to a log, watched, and on request learning on."""

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from math import nan
from typing import Self

import numpy as np

from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.drift import Drift
from stepgap.learning.observations import error_of, history_after, next_history, observe
from stepgap.learning.place_effects import without_place_effects
from stepgap.learning.residual import Residual, join_points, no_residual
from stepgap.learning.residual_fit import fit_residual
from stepgap.learning.settings import LearningSettings
from stepgap.learning.step_log import LoggedStep, StepLog
from stepgap.step import Array, StepMap, StepRecord, StepStatus

WATCHED = 10
"""Steps over which a correction is compared with the nominal map."""
SIGNIFICANT = 2.0
"""Standard errors by which it must have predicted worse to be left out."""
GROWTH = 1.1
"""Factor by which the steps must have grown in number before the next fit begins."""
FITTED_A_HOP = 150
"""Steps that a fit handles, at least, while the robot hops once."""

Lesson = tuple[Array, Array, Array]
"""History, point and error of a step that is learnt from."""


class Learner:
    """The corrected map from step to step of one deployment.

    A correction that predicted the last steps significantly worse than the nominal map is left out until it predicts
    better again, and it is shifted by what drifts, from hop to hop and from place to place. Learning online, every step
    enters the model before the next is planned, and the hyper-parameters are fitted anew beside the hopping: a fit
    begins when the command is out, so that it delays none, and is taken over a fixed number of steps later, however
    long it took, so that the same steps give the same commands.

    Args:
        nominal: Map of the physics model.
        log: Steps known before the deployment.
        learning: What models the error, and whether steps of this deployment are learnt from.
        iteration: Number of the deployment.
    """

    def __init__(self, nominal: StepMap, log: StepLog, learning: LearningSettings, iteration: int):
        self.nominal, self._learning = nominal, learning
        self._iteration, self._lessons = iteration, learning.lessons(iteration)
        self._log = StepLog(log.space, log)
        self._residual = self._fitted(self._log, None)
        self._drift, self._place = Drift.none(len(log.space.state)), nan
        self._advantage: deque[float] = deque(maxlen=WATCHED)
        self._pool = ThreadPoolExecutor(1)
        self._fit: Future[Residual] | None = None
        self._due, self._next_fit = 0, max(1.0, GROWTH * len(log))
        self._history = next_history(self._log, nominal, iteration)
        self._failures = [_point_of(step.record) for step in log if step.record.status != StepStatus.OK]
        self._since: list[Lesson] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    @property
    def residual(self) -> Residual:
        """Model of actual − nominal for the step to come."""
        return self._residual.conditioned_on(self._history)

    @property
    def failures(self) -> Array:
        """Points (state, command) of the steps that failed; shape (k, n + m)."""
        return np.array(self._failures).reshape(len(self._failures), sum(self._residual.sizes))

    def step_map(self) -> CorrectedMap:
        """The map to plan the next step with."""
        advantage = np.array(self._advantage)
        worse = len(advantage) == WATCHED and advantage.sum() < -SIGNIFICANT * np.sqrt(np.sum(advantage**2))
        if worse:
            return CorrectedMap(self.nominal, no_residual(*self._residual.sizes))
        residual, offset, share = self.residual, self._drift.offset(self._place), self._drift.std(self._place)
        return CorrectedMap(self.nominal, residual, offset, share * residual.noise_std)

    def observe(self, logged: LoggedStep) -> None:
        """Takes in the step just executed."""
        record, scale, history = logged.record, self.nominal.space.state_scale, self._history
        place, self._place = self._place, logged.record.place_after
        self._log.append(logged)
        if record.status != StepStatus.OK:
            self._failures.append(_point_of(record))
        error, point = error_of(record, self.nominal), _point_of(record)
        self._history = history_after(record, error, self.nominal.space, len(self._log))
        if not np.isfinite(error).all():
            return
        residual = self._residual.conditioned_on(history)
        left = error - residual.mean(point)
        missed = left - self._drift.offset(place)  # by the correction with the shift that it is deployed with
        self._advantage.append(float(np.sum((error / scale) ** 2) - np.sum((missed / scale) ** 2)))
        if self._learning.drift and residual.kind != "none":
            self._drift = self._drift.followed(left, place)
        if self._lessons > 0:
            self._lessons -= 1
            self._learn((history, point, error))

    def fit_beside(self) -> None:
        """Begins a fit where the steps have grown in number, and teaches the one that goes on the steps since.

        To be called when the command is out: while the robot hops there is time for it.
        """
        count = len(self._log)
        if self._fit is not None:
            self._fit = self._pool.submit(_taught, self._fit, self._since)
        elif self._lessons > 0 and count >= self._next_fit:
            self._fit = self._pool.submit(self._fitted, StepLog(self._log.space, self._log), self._residual)
            self._due = count + 1 + count // FITTED_A_HOP
            self._next_fit = max(GROWTH * count, self._due + 1)
        self._since = []

    def _learn(self, lesson: Lesson) -> None:
        """Lets a step enter the model: the present one, that of the last fit, or of a fit that is now due."""
        self._since.append(lesson)
        if not self._lessons > 0:
            self._residual, self._fit = self._fitted(self._log, self._residual), None
        elif self._fit is not None and len(self._log) >= self._due:
            self._residual, self._fit = _taught(self._fit, self._since), None
        else:
            history, point, error = lesson
            self._residual = self._residual.conditioned_on(history).append(point, error)

    def _fitted(self, log: StepLog, start: Residual | None) -> Residual:
        learning, errors = self._learning, observe(log, self.nominal)
        kind = learning.residual if len(errors) else "none"
        if learning.drift and kind != "none":
            cleaned = without_place_effects(errors, self._iteration)
            residual = fit_residual(kind, cleaned, learning.features, learning.memory, start)
            if residual.kind != "none":
                return residual
            kind = "none"  # without a correction nothing is followed: what the place adds is noise
        return fit_residual(kind, errors, learning.features, learning.memory, start)


def _taught(fit: Future[Residual], lessons: Sequence[Lesson]) -> Residual:
    """What a fit gives, with the steps since."""
    residual = fit.result()
    for history, point, error in lessons:
        residual = residual.conditioned_on(history).append(point, error)
    return residual


def _point_of(record: StepRecord) -> Array:
    """State and applied command of a step; shape (n + m,)."""
    return join_points(record.state, record.applied)
