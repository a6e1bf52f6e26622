"""The diagnosis of a run in sentences: units, offsets, response to commands, commands at their bounds, alarms."""

from typing import Final

import numpy as np

from stepgap.experiment.command_response import command_response
from stepgap.experiment.deployment import NO_PLAN
from stepgap.experiment.outcome import far_states, offset_sentences
from stepgap.experiment.run import Run
from stepgap.learning.steps import Steps
from stepgap.records.missing import Missing
from stepgap.records.text import capitalised, listed
from stepgap.step import Array, StepMap

OFFSET_ADVICE: Final = (
    "No command that was tried made up for this, so further redeployments would hardly help. Compare the range of the "
    "robot with that of the targets, unit and zero of the sensor, and what the commands move."
)
"""What to do about a coordinate that ends on the same side of all targets."""

AT_A_BOUND: Final = 0.99  # A command counts as at its bound beyond this part of its half range
OFTEN: Final = 0.1  # Part of the steps from which on a command at its bound is worth a sentence


def diagnosis_sentences(run: Run) -> list[str]:
    """Sentences on the first recorded deployment, and on errors and commands at their bounds in the last one."""
    first = run.steps.of_iteration(run.steps.iterations[0])
    last = run.steps.of_iteration(run.steps.iterations[-1])
    offsets = [f"{sentence} {OFFSET_ADVICE}" for sentence in offset_sentences(last)]
    lost = [sentence for number in run.steps.iterations for sentence in _lost(run.steps.of_iteration(number))]
    if isinstance(run.nominal, Missing):
        return [*far_states(first), *lost, *offsets, f"Not available: {run.nominal.reason}."]
    deployments = [first] if len(run.steps.iterations) == 1 else [first, last]
    bounds = [sentence for steps in deployments for sentence in bound_sentences(steps)]
    return [*far_states(first), *lost, *offsets, *response_sentences(first, run.nominal), *bounds]


def _lost(steps: Steps) -> list[str]:
    """A sentence if the search found no command for some steps of a deployment; they have a deviation nevertheless."""
    tracking = steps.tracking()
    missing = ~np.isfinite(tracking.predicted).all(axis=1) & np.isfinite(tracking.std).all(axis=1)
    if not missing.any():
        return []
    first = tracking.number[missing][0]
    return [
        f"In {np.count_nonzero(missing)} of the {len(tracking)} steps of deployment {steps.iterations[0]}, first in "
        f"step {first}, {NO_PLAN}."
    ]


def response_sentences(steps: Steps, nominal: StepMap) -> list[str]:
    """Coordinates that do not respond to the commands of one deployment as the nominal map says."""
    response = command_response(steps, nominal)
    number = steps.iterations[0]
    if response is None:
        return []
    rows = list(zip(steps.space.state, response.acts, response.acts_later, response.expected, strict=True))
    sentences = [
        f"{quantity.name} follows the command of the step before, not that of the same step, in deployment {number}: "
        "the command acts one step later than the nominal map assumes."
        for quantity, now, later, _ in rows
        if later and not now
    ]
    dead = [quantity.name for quantity, now, later, expected in rows if expected and not now and not later]
    if dead:
        sentences.append(
            f"The {response.steps} steps of deployment {number} show no effect of the commands on {listed(dead)}, but "
            "by the nominal map it would be clearly seen: check that the commands reach the robot, and their units."
        )
    return [capitalised(sentence) for sentence in sentences]


def bound_sentences(steps: Steps) -> list[str]:
    """Commands that were often at their bounds in a deployment."""
    return [
        f"{quantity.name} was at a bound in {100 * part:.0f} % of the steps of deployment {steps.iterations[0]}: its "
        "bounds may be too narrow for these targets, or the drives deliver less than is commanded."
        for quantity, part in zip(steps.space.command, parts_at_bounds(steps), strict=True)
        if part > OFTEN
    ]


def parts_at_bounds(steps: Steps) -> Array:
    """Part of the steps in which each command was at a bound; shape (m,)."""
    return np.mean(np.abs(steps.space.point_of(steps.requested)) > AT_A_BOUND, axis=0)


MOST_ALARMS: Final = 6  # A deployment with more alarms gets a sentence on their number


def trust_sentences(run: Run) -> list[str]:
    """Sentences on the alarms of the finished deployments."""
    sentences = []
    for deployment in run.summary.deployments:
        name = f"Deployment {deployment.iteration}"
        alarms = deployment.alarms
        if len(alarms) > MOST_ALARMS:
            sentences.append(f"{name}: {len(alarms)} times the robot was found to be another one.")
        else:
            sentences += [f"{name}: {alarm.sentence}." for alarm in alarms]
    return sentences
