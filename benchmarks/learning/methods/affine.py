"""Methods whose nominal map is affine: crude templates, and adaptive linear step-to-step dynamics.

On an affine map every step succeeds. So the checks of the controller that a step makes an apex and that its next state
is viable are void with these methods.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from benchmarks.learning.methods.redeployment import from_the_first_hop, redeployed
from benchmarks.learning.trial import Trial
from stepgap.control.reference import Reference
from stepgap.experiment.settings import METHODS
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.nominal_maps.linearised_map import linearised
from stepgap.step import Array, StepMap

TEMPLATE_SCALE = 0.7
"""Factor by which the derivatives of the template are too small."""


def template(nominal: StepMap, reference: Reference) -> AffineMap:
    """A template of four numbers: next = x₀ + B (u − u₀), as if each step forgot the state it starts from.

    x₀ is the mean target, u₀ the nominal command that keeps it. B are the derivatives of the nominal map there, rounded
    to one significant digit, times 0.7. So the size of the command's effect is known, but not well, and nothing else.
    """
    exact = linearised(nominal, reference.mean_target)
    n = len(exact.state)
    effect = TEMPLATE_SCALE * one_digit(exact.matrix[:, n:])
    return AffineMap(nominal.space, exact.state, exact.command, exact.state, np.hstack([np.zeros((n, n)), effect]))


def one_digit(values: Array) -> Array:
    """Numbers rounded to one significant digit; shape as given."""
    return np.array([float(f"{value:.0e}") for value in values.ravel()]).reshape(values.shape)


def template_uncorrected(trial: Trial) -> Sequence[Steps]:
    """Deployment 0 with the template alone."""
    return [trial.measure(trial.uncorrected(template(trial.nominal, trial.task.reference)), 0)]


def template_residual(trial: Trial, kind: str) -> Sequence[Steps]:
    """A redeployment with a residual of the template, learned from a deployment 0 with the template alone."""
    nominal, first = template_start(trial)
    return redeployed(trial, nominal, [first], LearningSettings(residual=kind))


def template_online(trial: Trial) -> Sequence[Steps]:
    """Deployment 0 with the template and the default residual, learned after every hop."""
    nominal = template(trial.nominal, trial.task.reference)
    return from_the_first_hop(trial, LearningSettings(online=True), nominal)


@lru_cache(maxsize=1)
def template_start(trial: Trial) -> tuple[AffineMap, Steps]:
    """The template, and the deployment with it alone that the residuals of the template are learned from."""
    nominal = template(trial.nominal, trial.task.reference)
    return nominal, trial.deploy(trial.uncorrected(nominal), 0)


def rls(trial: Trial) -> Sequence[Steps]:
    """The method `rls` of a run: adaptive linear step-to-step dynamics."""
    nominal = linearised(trial.nominal, trial.task.reference.mean_target)
    return redeployed(trial, nominal, [trial.first], METHODS["rls"].learning)
