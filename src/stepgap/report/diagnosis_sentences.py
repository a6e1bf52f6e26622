"""The diagnosis of the first deployment in sentences: units, lagged inputs, noise that varies, authority."""

import numpy as np

from stepgap.experiment.diagnosis import SMALLEST_GAIN, Diagnosis, diagnose, part_at_bounds
from stepgap.experiment.run import Run
from stepgap.experiment.state_ranges import far_states
from stepgap.learning.observations import Observations, observe
from stepgap.learning.steps import Steps
from stepgap.records.missing import Missing
from stepgap.report.text import decimal
from stepgap.step import StepMap, StepSpace

WORTH_MENTION = 1.25
"""Smallest ratio of noises that is worth a sentence."""

OFTEN = 0.1
"""Part of the steps from which on a command at its bound is worth a sentence."""


def diagnosis_sentences(run: Run) -> list[str]:
    """Sentences on the first recorded deployment, and on commands at their bounds in the last one."""
    first = run.steps.of_iteration(run.steps.iterations[0])
    if isinstance(run.nominal, Missing):
        return [*far_states(first), f"Not available: {run.nominal.reason}."]
    return [*far_states(first), *_of_nominal(run, run.nominal)]


def _of_nominal(run: Run, nominal: StepMap) -> list[str]:
    """The sentences for which the errors of the nominal map are needed."""
    first, last = run.steps.iterations[0], run.steps.iterations[-1]
    steps, space = run.steps.of_iteration(first), run.space
    observed = observe(steps, nominal)
    found = diagnose(observed, nominal)
    if not found.known:
        counted = f"Deployment {first} has {found.steps} steps with a known error"
        return [f"{counted}, too few to diagnose lagged inputs and noise.", *_authority(found, space, steps)]
    deployments = {first: observed}
    if last != first:
        deployments[last] = observe(run.steps.of_iteration(last), nominal)
    return [
        *_lagged_inputs(found, space, first),
        *_noise(found, space),
        *_authority(found, space, steps),
        *(sentence for number, each in deployments.items() for sentence in _bounds(number, each)),
    ]


def _lagged_inputs(found: Diagnosis, space: StepSpace, number: int) -> list[str]:
    """Whether the step before helps to predict the error of the next one."""
    sentences = []
    for row, quantity in enumerate(space.state):
        error, step = (100 * found.gains[name][row] for name in ("previous_error", "previous_step"))
        if max(error, step) > 100 * SMALLEST_GAIN:
            sentences.append(
                f"The step before helps to predict the error of {quantity.name}: as an input, its error reduces what "
                f"state and command leave unexplained by {error:.0f} %, together with its command and state by "
                f"{step:.0f} %. So the state does not contain all that the next step depends on, or a disturbance "
                "changes slowly. Measure what is missing, or use learning.lagged_inputs = 'auto'."
            )
    if not sentences:
        names = " and ".join(quantity.name for quantity in space.state)
        sentences.append(
            f"The step before does not help to predict the error of {names} ({found.steps} steps of deployment "
            f"{number}): as far as they show, the state is sufficient."
        )
    return sentences


def _noise(found: Diagnosis, space: StepSpace) -> list[str]:
    return [
        f"The unexplained error of {quantity.name} depends on state and command: in some parts of their range it is "
        f"{ratio:.1f} times as large as in others. The learned model has one noise level, so its intervals are too "
        "narrow in the former and too wide in the latter."
        for quantity, ratio in zip(space.state, found.heteroscedasticity, strict=True)
        if ratio > WORTH_MENTION
    ]


def _authority(found: Diagnosis, space: StepSpace, steps: Steps) -> list[str]:
    """Whether the commands can move the state in one step by as much as the targets change."""
    if not np.isfinite(found.authority).all() or len(steps) < 2:
        return []
    effect = 2 * found.authority.sum(axis=1) * space.state_scale  # from one end of the bounds to the other
    largest = np.abs(np.diff(steps.tracking().target, axis=0)).max(axis=0, initial=0.0)
    weak = [
        f"{one.name} by only {decimal(most)} {one.unit} in one step, but its target changes by "
        f"{decimal(change)} {one.unit}"
        for one, most, change in zip(space.state, effect, largest, strict=True)
        if most < change
    ]
    if weak:
        return [f"From one end of their bounds to the other, the commands move {'; and '.join(weak)}."]
    return ["Within their bounds the commands move the state in one step by more than the targets change."]


def _bounds(number: int, observed: Observations) -> list[str]:
    """Commands that were often at their bounds in a deployment."""
    return [
        f"{quantity.name} was at a bound in {100 * part:.0f} % of the steps of deployment {number}: its bounds may be "
        "too narrow for these targets, or the drives deliver less than is commanded."
        for quantity, part in zip(observed.space.command, part_at_bounds(observed), strict=True)
        if part > OFTEN
    ]
