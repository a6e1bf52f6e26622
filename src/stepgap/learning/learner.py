"""What is known of the map's error at every step: a residual fitted to a log, watched and, on request, kept learning."""

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Self

import numpy as np

from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.fit_residual import ResidualKind, fit_residual
from stepgap.learning.observations import observe
from stepgap.learning.residual import Residual, join_points, no_residual
from stepgap.learning.step_log import LoggedStep, StepLog
from stepgap.step import Array, Reason, StepMap

WATCHED = 10
"""Steps over which a correction is compared with the nominal map."""
SIGNIFICANT = 2.0
"""Standard errors by which it must have predicted worse to be left out."""
GROWTH = 1.1
"""Factor by which the steps must have grown in number before the next fit begins."""
FITTED_A_HOP = 150
"""Steps that a fit handles, at least, while the robot hops once."""


class Learner:
    """The corrected map from step to step of one deployment.

    A correction that predicted the last steps significantly worse than the nominal map is left out until it predicts
    better again. Learning online, every step enters the model before the next is planned, and the hyper-parameters are
    fitted anew beside the hopping: a fit is taken over a fixed number of steps after it began, however long it took, so
    that the same steps give the same commands.

    Args:
        nominal: Map of the physics model.
        log: Steps known before the deployment.
        kind: What models the error.
        lessons: Steps of the deployment that it learns from; inf for all of them.
    """

    def __init__(self, nominal: StepMap, log: StepLog, kind: ResidualKind, lessons: float = 0):
        self.nominal, self._kind, self._lessons = nominal, kind, lessons
        self._log = StepLog(log.space, log)
        self._residual = self._fitted(self._log)
        self._advantage: deque[float] = deque(maxlen=WATCHED)
        self._pool = ThreadPoolExecutor(1)
        self._fit: Future[Residual] | None = None
        self._fitted_steps = self._due = len(self._log)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    @property
    def residual(self) -> Residual:
        """Model of actual − nominal, as it stands."""
        return self._residual

    @property
    def failures(self) -> Array:
        """Points (state, command) of the steps that failed; shape (k, n + m)."""
        failed = [step.record for step in self._log if step.record.reason != Reason.OK]
        points = [np.concatenate([record.state, record.applied]) for record in failed]
        return np.array(points).reshape(len(points), sum(self._residual.sizes))

    def step_map(self) -> CorrectedMap:
        """The map to plan the next step with."""
        advantage = np.array(self._advantage)
        worse = len(advantage) == WATCHED and advantage.sum() < -SIGNIFICANT * np.sqrt(np.sum(advantage**2))
        return CorrectedMap(self.nominal, no_residual(*self._residual.sizes) if worse else self._residual)

    def observe(self, logged: LoggedStep) -> None:
        """Takes in the step just executed."""
        record, scale = logged.record, self.nominal.space.state_scale
        self._log.append(logged)
        error = record.next_state - self.nominal.evaluate(record.state, record.applied).next_state
        if not np.isfinite(error).all():
            return
        point = join_points(record.state, record.applied)
        left = error - self._residual.mean(point)
        self._advantage.append(float(np.sum((error / scale) ** 2) - np.sum((left / scale) ** 2)))
        if self._lessons > 0:
            self._lessons -= 1
            self._residual = self._residual.append(point, error)
            self._fit_beside()

    def _fit_beside(self) -> None:
        """Begins a fit where the steps have grown in number, and takes over the one that is due."""
        count = len(self._log)
        if not self._lessons > 0:
            self._residual, self._fit = self._fitted(self._log), None
        elif self._fit is None and count >= GROWTH * self._fitted_steps:
            self._fit = self._pool.submit(self._fitted, StepLog(self._log.space, self._log))
            self._fitted_steps, self._due = count, count + 1 + count // FITTED_A_HOP
        elif self._fit is not None and count >= self._due:
            residual, self._fit = self._fit.result(), None
            later = observe(StepLog(self._log.space, list(self._log)[self._fitted_steps :]), self.nominal)
            for point, error in zip(later.points, later.error, strict=True):
                residual = residual.append(point, error)
            self._residual = residual

    def _fitted(self, log: StepLog) -> Residual:
        observations = observe(log, self.nominal)
        return fit_residual(self._kind if len(observations) else "none", observations)
