"""The results of a run in sentences: the headline, and what is unusual."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from stepgap.experiment.outcome import TRACKED
from stepgap.experiment.run import Run
from stepgap.records.summary import Deployment
from stepgap.records.text import between, capitalised, decimal, in_words, listed, unit_suffix
from stepgap.report.drift import drift_sentences
from stepgap.report.verdict import CLOSE, NEAR_FLOOR, Achievement
from stepgap.robots.published_result import PublishedResult
from stepgap.step import Array, StepStatus, ending_of

MOST_NAMED = 6  # Largest number of targets that a sentence names


def headline(run: Run) -> str:
    """Sentence on whether the run tracked its reference, and what learning changed."""
    if not run.deployments:
        return "No deployment is finished yet."
    achieved = Achievement(run)
    last = achieved.last
    if last.failed_steps:
        return f"It did not track to the end: {_ended(run, last)}."
    to_end = f"the last deployment made all its {_count(last.steps, 'step')} without a fall"
    far = achieved.beyond()
    if far:
        names = run.space.state_names
        errors = listed([f"the error of {names[row]} is {achieved.in_words(row)}" for row in far])
        verdict = f"It did not track: {errors}. But {to_end}"
        if all(achieved.parts[row] <= CLOSE for row in far):
            verdict = f"It followed its targets closely, {errors}: {to_end}"
    elif np.isfinite(achieved.floor[achieved.rows]).all() and not any(map(achieved.is_doubtful, achieved.rows)):
        verdict = f"It tracked: {to_end}"
    else:
        verdict = capitalised(to_end)
    return f"{verdict}{_compared(achieved)}."


def sentences(run: Run) -> list[str]:
    """Sentences on what is unusual: failed steps, limits, targets that were not held, unfinished deployments."""
    ended = [capitalised(_ended(run, deployment)) for deployment in run.deployments if deployment.failed_steps]
    return [
        *(f"{sentence}; its errors include only the steps before." for sentence in ended),
        *_grounds(run),
        *_limits(run),
        *drift_sentences(run),
        *(
            f"Deployment {iteration} is running or was interrupted: "
            f"its {_count(steps, 'step')} so far are not included in the errors."
            for iteration, steps in run.unfinished.items()
        ),
    ]


def recorded(run: Run) -> str:
    """Sentence on the steps of a run, and on those without a next state."""
    return (
        f"{_count(len(run.steps), 'step')} recorded in {_count(len(run.steps.iterations), 'deployment')} "
        f"on the {run.plant}, {_failures(run)}."
    )


def _compared(achieved: Achievement) -> str:
    """Phrase on the errors before and after learning, and on when they became small; it begins with a comma."""
    first = achieved.first
    alone = first is achieved.last
    if first.failed_steps and not alone:
        return f", whereas {_ended(achieved.run, first)}"
    if not achieved.learned:
        return ", with the nominal map: nothing was learned yet" if alone else ""
    steps = achieved.steps_to_band() if achieved.predicted else None
    if not steps:
        return _changes(achieved)
    return f"{_changes(achieved)}; after {steps} executed steps they stayed within {achieved.band[0]}"


def _changes(achieved: Achievement) -> str:
    """Phrase on which errors are smaller and larger than before; it begins with a comma or a full stop."""
    changes = np.array(achieved.changes())
    names = np.array([achieved.run.space.state_names[row] for row in achieved.rows])
    if achieved.predicted:
        base = than = "that of the nominal map's predictions"
    else:
        base = f"deployment {achieved.first.iteration}"
        than = f"in {base}"
    at_floor = (achieved.before <= NEAR_FLOOR * achieved.floor)[achieved.rows].all()
    reason = ": all were near the noise floor from the beginning" if at_floor else ""
    whole = (
        (np.isnan(changes).any(), f", but not every error is known, so that none is compared with {base}"),
        ((changes < 0).all(), f", and every tracking error is smaller than {than}"),
        (not changes.any(), f", and no tracking error is clearly smaller or larger than {than}{reason}"),
    )
    for holds, phrase in whole:
        if holds:
            return phrase
    groups = {"smaller": names[changes < 0], "larger": names[changes > 0], "not clearly changed": names[changes == 0]}
    parts = [f"{word} for {listed(list(group))}" for word, group in groups.items() if len(group)]
    return f". Compared with {base}, the error is {listed(parts)}"


def floor_sentences(run: Run) -> list[str]:
    """Sentence on the noise floor of the plant and what it means for a controller; empty if it is not known."""
    rows = [row for row, value in enumerate(run.noise_floor) if value > 0]
    if not rows or not run.deployments:
        return []
    if Achievement(run).is_without_noise:
        text = "Steps that are repeated with the same command end alike: the plant has no noise, and so no noise floor."
        return [text]
    values = _with_intervals(run, run.noise_floor, run.noise_floor_interval, rows)
    count = f"from {_count(run.noise_floor_steps, 'step')}, " if run.noise_floor_steps else ""
    if run.summary.noise_floor_measured:
        source = f"measured with the same command and the same motion at the start, but {_differences(run, rows)}"
        how = f"is {values}, {count}{source}"
    else:
        source = "the residual standard error of a linear fit to the steady steps of the last deployment"
        how = f"is at most about {values}, {count}{source}; the true noise floor may be smaller"
    return [f"The noise floor (standard deviation of repeated steps) {how}."]


def _differences(run: Run, rows: Sequence[int]) -> str:
    """In what repeated steps differ, and what this means for a controller."""
    periodic = run.steps.space.periodic
    if periodic is None or not np.isfinite(run.steps.phase).any():
        return (
            "with other noise. A controller that does not know the noise cannot have smaller steady errors on average"
        )
    alone = _with_intervals(run, run.noise_floor_same_phase, run.noise_floor_same_phase_interval, rows)
    return (
        f"at another {periodic.name} and with other noise. A controller that knows neither noise nor {periodic.name} "
        "cannot have smaller steady errors on average. The noise alone, at one "
        f"{periodic.name}, is {alone}: a controller that learns what returns with the {periodic.name} "
        "(learning.drift) can have steady errors between these two numbers"
    )


def _with_intervals(run: Run, floor: Array, ends: Array, rows: Sequence[int]) -> str:
    """Standard deviations (n,) of some coordinates, with their intervals (2, n) where these are known."""
    state = run.space.state
    return ", ".join(
        f"{state[row].name} {decimal(floor[row])}{unit_suffix(state[row])}{between(ends[:, row])}" for row in rows
    )


def _grounds(run: Run) -> list[str]:
    """Sentences on what states are measured above."""
    space = run.steps.space
    lines = []
    for name in dict.fromkeys(quantity.above for quantity in run.space.state if quantity.above):
        column = space.context_names.index(name)
        context = run.steps.context[:, column]
        measured = context[np.isfinite(context)]
        if not len(measured):
            continue
        changes = np.abs(np.diff(context, prepend=np.nan))[run.steps.follows]
        largest = np.nanmax(np.append(changes, 0.0))
        above = listed([quantity.name for quantity in run.space.state if quantity.above == name])
        unit = space.context[column].unit
        lines.append(
            f"{capitalised(above)} is measured above the {name} that each step found, which lay between "
            f"{decimal(measured.min(), 2)} and {decimal(measured.max(), 2)} {unit} and changed by up to "
            f"{decimal(largest, 2)} {unit} from a step to the next."
        )
    return lines


def _limits(run: Run) -> list[str]:
    """Sentences on cut commands, and on targets that were not held."""
    if not run.deployments:
        return []
    first = run.deployments[0]
    last = run.deployments[-1]
    of_first = "nominal map" if first.residual == "none" else f"map of deployment {first.iteration}"
    maps = {of_first: first, f"map of deployment {last.iteration}": last}
    included = "; the residual includes what they removed" if last.residual != "none" else ""
    table = [(last.cut, f"Limits cut {last.cut} of {last.steps} commands of deployment {last.iteration}{included}.")]
    table += [
        (len(entry.unreachable), f"Not held by any command within the bounds, by the {name}: {targets}.")
        for name, entry in maps.items()
        for targets in [_targets(run, entry.unreachable)]
    ]
    table.append(
        (
            len(last.missed),
            f"Missed in deployment {last.iteration}, with a steady error above {TRACKED:g} times the scatter of its "
            f"steady steps, although its map holds them: {_targets(run, last.missed)}.",
        )
    )
    return [sentence for count, sentence in table if count]


def _targets(run: Run, targets: Array) -> str:
    """Targets with their units."""
    count = _count(len(targets), "target")
    texts = [in_words(run.space.state, target) for target in targets[:MOST_NAMED]]
    more = f"; and {len(targets) - MOST_NAMED} more" if len(targets) > MOST_NAMED else ""
    return f"{count} ({'; '.join(texts)}{more})"


def published_sentence(result: PublishedResult) -> str:
    """Sentence on how far the errors of the published result decreased."""
    ratios = result.errors[0]["rmse"] / result.band
    factors = [f"{decimal(ratio, 2)} in {name}" for name, ratio in zip(result.reference.names, ratios, strict=True)]
    return (
        f"For comparison: on {result.source}'s hardware the RMSE decreased by a factor of {listed(factors)} with "
        f"{result.last} redeployments."
    )


def _count(number: int, noun: str) -> str:
    return f"{number or 'no'} {noun}{'' if number == 1 else 's'}"


def _ended(run: Run, deployment: Deployment) -> str:
    """Phrase on how a deployment was aborted."""
    status = _last_status(run, deployment)
    return f"deployment {deployment.iteration} {ending_of(status)} at step {deployment.steps}"


def end_in_a_word(run: Run, deployment: Deployment) -> str:
    """How a deployment ended, for a table: complete, or the status of its last step."""
    return _last_status(run, deployment).label.replace("_", " ") if deployment.failed_steps else "complete"


def _last_status(run: Run, deployment: Deployment) -> StepStatus:
    return list(run.steps.of_iteration(deployment.iteration))[-1].record.status


def _failures(run: Run) -> str:
    """Numbers of the steps without a next state, by their status."""
    counts = Counter(logged.record.status for logged in run.steps)
    falls = counts[StepStatus.FELL]
    stops = counts[StepStatus.STOPPED]
    doubts = counts[StepStatus.DOUBTFUL]
    unstable = counts[StepStatus.UNSTABLE]
    others = run.steps.failed_steps - falls - stops - doubts - unstable
    table = (
        (falls or not run.steps.failed_steps, _count(falls, "fall")),
        (stops, f"{_count(stops, 'step')} stopped by the plant"),
        (doubts, f"{_count(doubts, 'step')} stopped because of a doubtful sensor"),
        (unstable, f"{_count(unstable, 'step')} in which the simulation became unstable"),
        (others, f"{_count(others, 'step')} without a next state for other reasons"),
    )
    return ", ".join(phrase for holds, phrase in table if holds)
