"""The diagnosis of a run in sentences: units, offsets, lagged inputs, noise that varies, response to commands."""

from stepgap.experiment.command_response import command_response
from stepgap.experiment.run import Run
from stepgap.experiment.state_ranges import far_states, offset_sentences
from stepgap.learning.diagnosis import SMALLEST_GAIN, Diagnosis, diagnose, part_at_bounds
from stepgap.learning.observations import Observations, observe
from stepgap.learning.posterior import POSTERIOR
from stepgap.learning.steps import Steps
from stepgap.records.missing import Missing
from stepgap.records.text import capitalised, decimal, listed
from stepgap.step import StepMap

WORTH_MENTION = 1.25
"""Smallest ratio of noises that is worth a sentence."""

OFFSET_ADVICE = (
    "No command that was tried made up for this, so further redeployments would hardly help. Compare the range of the "
    "robot with that of the targets, unit and zero of the sensor, and what the commands move."
)
"""What to do about a coordinate that ends on the same side of all targets."""

OFTEN = 0.1
"""Part of the steps from which on a command at its bound is worth a sentence."""


def diagnosis_sentences(run: Run) -> list[str]:
    """Sentences on the first recorded deployment, and on errors and commands at their bounds in the last one."""
    first = run.steps.of_iteration(run.steps.iterations[0])
    last = run.steps.of_iteration(run.steps.iterations[-1])
    offsets = [f"{sentence} {OFFSET_ADVICE}" for sentence in offset_sentences(last)]
    if isinstance(run.nominal, Missing):
        return [*far_states(first), *offsets, f"Not available: {run.nominal.reason}."]
    return [*far_states(first), *offsets, *_of_nominal(run, run.nominal)]


def _of_nominal(run: Run, nominal: StepMap) -> list[str]:
    """The sentences for which the errors of the nominal map are needed."""
    first, last = run.steps.iterations[0], run.steps.iterations[-1]
    steps = run.steps.of_iteration(first)
    observed = observe(steps, nominal)
    found = diagnose(observed)
    deployments = {first: observed}
    if last != first:
        deployments[last] = observe(run.steps.of_iteration(last), nominal)
    few = f"Deployment {first} has {found.steps} steps with a known error, too few to diagnose lagged inputs and noise."
    return [
        *([*_lagged_inputs(run, found, first), *_noise(run, found)] if found.known else [few]),
        *response_sentences(steps, nominal),
        *(sentence for number, each in deployments.items() for sentence in _bounds(number, each)),
    ]


def _lagged_inputs(run: Run, found: Diagnosis, number: int) -> list[str]:
    """Whether the step before helps to predict the error of the next one."""
    sentences, space = [], run.space
    last = run.steps.iterations[-1]
    residual = run.residual(last)
    if not isinstance(residual, Missing) and residual.history_inputs.lagged_inputs != "none":
        advice = f"; the residual of deployment {last} has such inputs"
    elif not isinstance(residual, Missing) and residual.kind == POSTERIOR.name:
        advice = "; what is believed of the robot includes an effect of its error and command"
    elif not isinstance(run.settings, Missing) and run.settings.learning.lagged_inputs == "none":
        advice = ", or use learning.lagged_inputs = 'auto'"
    else:
        advice = "; a residual has such inputs where it predicts better with them (learning.lagged_inputs)"
    for row, quantity in enumerate(space.state):
        error, step = (100 * found.gains[name][row] for name in ("previous_error", "previous_step"))
        if max(error, step) > 100 * SMALLEST_GAIN:
            gains = {"its error": error, "its error, command and state": step}
            parts = [f"by {gain:.0f} % with {what}" for what, gain in gains.items() if gain > 0]
            sentences.append(
                f"The step before helps to predict the error of {quantity.name}, beyond state and command. "
                f"With inputs from the step before it is smaller, {listed(parts)}. So the state does not contain all "
                f"that the next step depends on, or a disturbance changes slowly. Measure what is missing{advice}."
            )
    if not sentences:
        names = listed([quantity.name for quantity in space.state])
        sentences.append(
            f"The step before does not help to predict the error of {names} ({found.steps} steps of deployment "
            f"{number}): as far as they show, the state is sufficient."
        )
    return sentences


def _noise(run: Run, found: Diagnosis) -> list[str]:
    verb = "has" if run.steps.std.any() else "would have"
    return [
        f"The unexplained error of {quantity.name} depends on state and command: in some parts of their range it is "
        f"{decimal(ratio, 2)} times as large as in others. A learned model {verb} one noise level, so its own "
        "intervals are too narrow in the former and too wide in the latter; those of a deployment are calibrated."
        for quantity, ratio in zip(run.space.state, found.heteroscedasticity, strict=True)
        if ratio > WORTH_MENTION
    ]


def response_sentences(steps: Steps, nominal: StepMap) -> list[str]:
    """Coordinates that do not respond to the commands of one deployment as the nominal map says."""
    found, number = command_response(steps, nominal), steps.iterations[0]
    if found is None:
        return []
    late = [
        f"{quantity.name} follows the command of the step before, not that of the same step, in deployment {number}: "
        "the command acts one step later than the nominal map assumes."
        for quantity, now, later in zip(steps.space.state, found.acts, found.acts_later, strict=True)
        if later and not now
    ]
    rows = zip(steps.space.state, found.acts, found.acts_later, found.expected, strict=True)
    dead = [quantity.name for quantity, now, later, expected in rows if expected and not now and not later]
    if dead:
        late.append(
            f"The {found.steps} steps of deployment {number} show no effect of the commands on {listed(dead)}, but "
            "by the nominal map it would be clearly seen: check that the commands reach the robot, and their units."
        )
    return [capitalised(sentence) for sentence in late]


def _bounds(number: int, observed: Observations) -> list[str]:
    """Commands that were often at their bounds in a deployment."""
    return [
        f"{quantity.name} was at a bound in {100 * part:.0f} % of the steps of deployment {number}: its bounds may be "
        "too narrow for these targets, or the drives deliver less than is commanded."
        for quantity, part in zip(observed.space.command, part_at_bounds(observed), strict=True)
        if part > OFTEN
    ]
