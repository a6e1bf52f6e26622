"""Methods whose nominal map is affine: crude templates, and adaptive linear step-to-step dynamics.

On an affine map every step succeeds. So the checks of the controller that a step makes an apex and that its next state
is viable are void with these methods.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from math import log

import numpy as np

from benchmarks.learning.methods.redeployment import from_the_first_hop, redeployed
from benchmarks.learning.trial import Trial
from stepgap.control.reference import Reference
from stepgap.control.step_controller import StepController
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.step import Array, StepMap

TEMPLATE_SCALE = 0.7
"""Factor by which the derivatives of the template are too small."""

RLS_FORGETTING = 0.99
"""Factor of the weight of a step's error after every further step, in the method `rls`."""

PLAIN_RLS_FORGETTING = 0.99
"""That factor in the method `rls_plain`; it was not tuned on its own."""


def linearised(nominal: StepMap, reference: Reference) -> AffineMap:
    """A map linearised at the mean target of a reference, in the limit cycle there."""
    state = mean_target(reference)
    command = StepController(nominal)(state, state).command
    return AffineMap(nominal.space, state, command, nominal(state, command), nominal.jacobian(state, command))


def template(nominal: StepMap, reference: Reference) -> AffineMap:
    """A template of four numbers: next = x₀ + B (u − u₀), as if each step forgot the state it starts from.

    x₀ is the mean target, u₀ the nominal command that keeps it. B are the derivatives of the nominal map there, rounded
    to one significant digit, times 0.7. So the size of the command's effect is known, but not well, and nothing else.
    """
    exact = linearised(nominal, reference)
    n = len(exact.state)
    effect = TEMPLATE_SCALE * one_digit(exact.matrix[:, n:])
    return AffineMap(nominal.space, exact.state, exact.command, exact.state, np.hstack([np.zeros((n, n)), effect]))


def mean_target(reference: Reference) -> Array:
    """Mean of the targets from the first change on, before which a deployment starts; shape (n,)."""
    first = reference.changes[0] if len(reference.changes) else 0
    return reference.targets[first:].mean(axis=0)


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


def rls(trial: Trial, forgetting: float = RLS_FORGETTING) -> Sequence[Steps]:
    """Adaptive linear step-to-step dynamics next = A x + B u + c, with the disturbance filter.

    A, B and c start from the linearised nominal map and are updated after every step by recursive least squares with
    exponential forgetting, in the sense of adaptive step-to-step dynamics (arXiv 2209.08458). They are the linearised
    map plus the residual `linear` with a forgetting time, which is updated online. Its prior keeps its weight, so the
    estimate does not wind up where the steps do not excite it.
    """
    return _redeployed_rls(trial, rls_settings(forgetting))


def rls_plain(trial: Trial, forgetting: float = PLAIN_RLS_FORGETTING) -> Sequence[Steps]:
    """As `rls`, without the disturbance filter and the removal of the periodic part."""
    return _redeployed_rls(trial, replace(rls_settings(forgetting), drift=False, remove_yaw_dependence=False))


def rls_settings(forgetting: float) -> LearningSettings:
    """Settings with which a learner updates its linear residual by recursive least squares with a forgetting factor."""
    return LearningSettings(residual="linear", online=True, forgetting_time=-1 / log(forgetting))


def _redeployed_rls(trial: Trial, settings: LearningSettings) -> Sequence[Steps]:
    nominal = linearised(trial.nominal, trial.task.reference)
    return redeployed(trial, nominal, [trial.first], settings)
