"""Redeployments with what a learner learned from earlier deployments: residuals on the exact nominal map."""

import json
from collections.abc import Sequence

from stepgap.bench.trial import Trial
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.step_log import StepLog
from stepgap.step import StepMap

EXPLORATION = 20
"""Number of exploratory hops of the methods that explore."""


def redeployed(
    trial: Trial, nominal: StepMap, known: Sequence[StepLog], settings: LearningSettings
) -> Sequence[StepLog]:
    """Deployments made before, and one more by a learner that knows their steps.

    Args:
        trial: Twin and seed.
        nominal: Map that the learner corrects.
        known: Earlier deployments, from number 0 on.
        settings: Settings of the learner.
    """
    log = StepLog(nominal.space, (logged for deployment in known for logged in deployment))
    return [*known, trial.measure(Learner.start(nominal, log, settings, len(known)), len(known))]


def residual(trial: Trial, kind: str) -> Sequence[StepLog]:
    """One redeployment with a residual on the exact nominal map.

    `auto` chooses one of the others; then it makes the same deployment, which is not computed again.
    """
    learner = Learner.start(trial.nominal, trial.first, LearningSettings(residual=kind), 1)
    key = json.dumps(learner.residual.to_dict())
    if key not in trial.redeployed:
        trial.redeployed[key] = trial.measure(learner, 1)
    return [trial.first, trial.redeployed[key]]


def corrected(trial: Trial, settings: LearningSettings) -> Sequence[StepLog]:
    """One redeployment by a learner with the exact nominal map."""
    return redeployed(trial, trial.nominal, [trial.first], settings)


def uncorrected(trial: Trial) -> Sequence[StepLog]:
    """Deployment 0; if the task changes the robot, it is made again with that change."""
    return [trial.measure(trial.uncorrected(trial.nominal), 0) if trial.task.change else trial.first]


def from_the_first_hop(trial: Trial, settings: LearningSettings, nominal: StepMap | None = None) -> Sequence[StepLog]:
    """Deployment 0 by a learner that learns in it, with the exact nominal map or another one."""
    nominal = nominal or trial.nominal
    learner = Learner.start(nominal, StepLog(nominal.space), settings, 0)
    return [trial.measure(learner, 0, settings.exploration)]
