"""Methods that identify the parameters of the physics model.

They are compared fairly only if they go on learning during the deployment, as the default learner does. So the
identified map is the nominal map of a `Learner` with beliefs about what a constant residual leaves. The constant itself
has little to do, since the parameters were fitted to the same steps. The plain variants have neither.
"""

from collections.abc import Sequence
from functools import lru_cache

from benchmarks.learning.methods.physical_parameters import AdjustedMap, identify
from benchmarks.learning.methods.redeployment import redeployed
from benchmarks.learning.trial import Trial
from stepgap.learning.observations import observe
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps

LEARNING_ON = LearningSettings(residual="constant")
"""Settings of a learner that learns during the deployment."""


def identified(trial: Trial, settings: LearningSettings) -> Sequence[Steps]:
    """A redeployment with the model identified from the steps of deployment 0."""
    return redeployed(trial, identified_map(trial), [trial.first], settings)


@lru_cache(maxsize=1)
def identified_map(trial: Trial) -> AdjustedMap:
    """The model identified from the steps of deployment 0."""
    return identify(trial.nominal, observe(trial.first, trial.nominal))
