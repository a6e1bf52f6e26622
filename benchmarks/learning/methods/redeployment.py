"""Redeployments with what a learner learned from earlier deployments: residuals on the exact nominal map."""

import json
from collections.abc import Sequence
from dataclasses import asdict, replace

from benchmarks.learning.trial import Trial
from stepgap.experiment.settings import METHODS
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.step import StepMap

EXPLORATION = 20
"""Number of exploratory hops of the methods that explore."""


def redeployed(trial: Trial, nominal: StepMap, known: Sequence[Steps], settings: LearningSettings) -> Sequence[Steps]:
    """Deployments made before, and one more by a learner that knows their steps.

    Args:
        trial: Twin and seed.
        nominal: Map that the learner corrects.
        known: Earlier deployments, from number 0 on.
        settings: Settings of the learner.
    """
    log = Steps(nominal.space, (logged for deployment in known for logged in deployment))
    return [*known, trial.measure(trial.learner(nominal, log, settings, len(known)), len(known))]


def residual(trial: Trial, kind: str) -> Sequence[Steps]:
    """One redeployment with a residual on the exact nominal map.

    `auto` chooses one of the others; then it makes the same deployment, which is not computed again.
    """
    learner = trial.learner(trial.nominal, trial.first, LearningSettings(residual=kind), 1)
    key = json.dumps([learner.learned.to_dict(), dict(trial.learning), asdict(trial.control)])
    return [trial.first, trial.once(key, lambda: trial.measure(learner, 1))]


def corrected(trial: Trial, settings: LearningSettings) -> Sequence[Steps]:
    """One redeployment by a learner with the exact nominal map."""
    return redeployed(trial, trial.nominal, [trial.first], settings)


def paper(trial: Trial) -> Sequence[Steps]:
    """The published method: `fitrgp`, Eq. 13 without further rules, four redeployments, each with a new fit."""
    settings, control, _ = METHODS["paper"]
    trial, deployments = replace(trial, control=control), [trial.first]
    while len(deployments) < settings.iterations:
        log = Steps(trial.nominal.space, (logged for deployment in deployments for logged in deployment))
        learner = trial.learner(trial.nominal, log, settings, len(deployments))
        deployments.append(trial.deploy(learner, len(deployments)))
    return redeployed(trial, trial.nominal, deployments, settings)


def uncorrected(trial: Trial) -> Sequence[Steps]:
    """Deployment 0; if the task changes the robot, it is made again with that change."""
    return [trial.measure(trial.uncorrected(trial.nominal), 0) if trial.task.change else trial.first]


def from_the_first_hop(trial: Trial, settings: LearningSettings, nominal: StepMap | None = None) -> Sequence[Steps]:
    """Deployment 0 by a learner that learns in it, with the exact nominal map or another one."""
    nominal = nominal or trial.nominal
    learner = trial.learner(nominal, Steps(nominal.space), settings, 0)
    return [trial.measure(learner, 0, settings.exploration)]
