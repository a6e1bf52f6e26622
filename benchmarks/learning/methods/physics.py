"""Methods that identify the parameters of the physics model.

They are compared fairly only if they go on learning during the deployment, as the default learner does. So the
identified map is the nominal map of a `Learner` with beliefs about what a constant residual leaves. The constant itself
has little to do, since the parameters were fitted to the same steps. The plain variants have neither.
"""

from collections.abc import Sequence
from functools import lru_cache

import mujoco.sysid

from benchmarks.learning.methods.physical_parameters import AdjustedMap, identify
from benchmarks.learning.methods.redeployment import redeployed
from benchmarks.learning.trial import Trial
from stepgap.learning.observations import observe
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.robots.hopper.tick.tick_row import Tick
from stepgap.step import StepMap

LEARNING_ON = LearningSettings(residual="constant")
"""Settings of a learner that learns during the deployment."""

SYSID_MISSING = "" if hasattr(mujoco.sysid, "optimize") else "needs the packages of stepgap[sysid]"
"""Why `sysid` cannot be used; empty if it can."""


def identified(trial: Trial, settings: LearningSettings) -> Sequence[Steps]:
    """A redeployment with the model identified from the steps of deployment 0."""
    return redeployed(trial, identified_map(trial), [trial.first], settings)


def sysid(trial: Trial, settings: LearningSettings) -> Sequence[Steps]:
    """A redeployment with the model identified from all ticks of deployment 0."""
    return redeployed(trial, map_from_ticks(trial), [trial.first], settings)


@lru_cache(maxsize=1)
def identified_map(trial: Trial) -> AdjustedMap:
    """The model identified from the steps of deployment 0."""
    return identify(trial.nominal, observe(trial.first, trial.nominal))


@lru_cache(maxsize=1)
def map_from_ticks(trial: Trial) -> StepMap:
    """The model identified from all ticks of deployment 0; the nominal one if there was no step."""
    from benchmarks.learning.methods.tick_identification import identify_from_ticks

    rows: list[Sequence[float]] = []
    # exactly the same deployment
    again = trial.deploy(trial.uncorrected(trial.nominal), 0, on_ticks=lambda ticks, step: rows.extend(ticks))
    if not len(again):
        return trial.nominal
    return identify_from_ticks(trial.nominal, list(map(Tick.of, rows)), trial.twin_of(0).sensor_model)
