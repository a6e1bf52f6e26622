"""The results of a run in sentences: the headline, and what is unusual."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from stepgap.experiment.outcome import TRACKED
from stepgap.experiment.run import Run
from stepgap.records.summary import Deployment
from stepgap.records.text import between, capitalised, decimal, in_words, listed, unit_suffix
from stepgap.report.verdict import NEAR_FLOOR, Achievement
from stepgap.robots.published_result import PublishedResult
from stepgap.step import Array, StepStatus, ending_of

MOST_NAMED = 6
"""Largest number of targets that a sentence names."""


def headline(run: Run) -> str:
    """Sentence on whether the run tracked its reference, and what learning changed."""
    if not run.deployments:
        return "No deployment is finished yet."
    found = Achievement(run)
    last = found.last
    if last.failed_steps:
        return f"It did not track to the end: {_ended(run, last)}."
    to_end = f"the last deployment made all its {_count(last.steps, 'step')} without a fall"
    if far := found.beyond():
        ratios = {run.space.state[row].name: f"{decimal(ratio, 2)} noise floors" for row, ratio in far.items()}
        errors = [f"the error of {name} is {ratio}" for name, ratio in ratios.items()]
        verdict = f"It did not track: {listed(errors)}. But {to_end}"
    elif np.isfinite(found.floor[found.rows]).all():
        verdict = f"It tracked: {to_end}"
    else:
        verdict = capitalised(to_end)
    return f"{verdict}{_compared(found)}."


def sentences(run: Run) -> list[str]:
    """Sentences on what is unusual: failed steps, limits, targets that were not held, unfinished deployments."""
    return [
        *(
            f"{capitalised(_ended(run, deployment))}; its errors include only the steps before."
            for deployment in run.deployments
            if deployment.failed_steps
        ),
        *_grounds(run),
        *_limits(run),
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


def _compared(found: Achievement) -> str:
    """Phrase on the errors before and after learning, and on when they became small; it begins with a comma."""
    run, first = found.run, found.first
    if first.failed_steps and first is not found.last:
        return f", whereas {_ended(run, first)}"
    if not found.learned:
        return ", with the nominal map: nothing was learned yet" if first is found.last else ""
    steps = found.steps_to_band() if found.predicted else None
    within = f"; after {steps} executed steps they stayed within {found.band[0]}" if steps else ""
    return f"{_changes(found)}{within}"


def _changes(found: Achievement) -> str:
    """Phrase on which errors are smaller and larger than before; it begins with a comma."""
    changes, names = found.changes(), [found.run.space.state_names[row] for row in found.rows]
    than = "that of the nominal map's predictions" if found.predicted else f"in deployment {found.first.iteration}"
    if np.isnan(changes).any():
        return f", but not every error is known, so that none is compared with {than.removeprefix('in ')}"
    if all(change < 0 for change in changes):
        return f", and every tracking error is smaller than {than}"
    if not any(changes):
        at_floor = (found.before <= NEAR_FLOOR * found.floor)[found.rows].all()
        reason = ": all were near the noise floor from the beginning" if at_floor else ""
        return f", and no tracking error is clearly smaller or larger than {than}{reason}"
    words = {"smaller": -1, "larger": 1, "not clearly changed": 0}
    groups = {
        word: [name for name, each in zip(names, changes, strict=True) if each == sign] for word, sign in words.items()
    }
    parts = [f"{word} for {listed(group)}" for word, group in groups.items() if group]
    return f". Compared with {than.removeprefix('in ')}, the error is {listed(parts)}"


def floor_sentences(run: Run) -> list[str]:
    """Sentence on the noise floor of the plant and what it means for a controller; empty if it is not known."""
    known = [row for row, value in enumerate(run.noise_floor) if value > 0]
    if not known or not run.deployments:
        return []
    if Achievement(run).is_without_noise:
        return [
            "Steps that are repeated with the same command end alike: the plant has no noise, and so no noise floor."
        ]
    values = _with_intervals(run, run.noise_floor, run.noise_floor_interval, known)
    count = f"from {_count(run.noise_floor_steps, 'step')}, " if run.noise_floor_steps else ""
    how = (
        f"is {values}, {count}measured with the same command and the same motion at the start, but "
        f"{_differences(run, known)}"
        if run.summary.noise_floor_measured
        else f"is at most about {values}, {count}the residual standard error of a linear fit to the steady steps of "
        "the last deployment; the true noise floor may be smaller"
    )
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
    found = []
    for name in dict.fromkeys(each.above for each in run.space.state if each.above):
        names = run.steps.space.context
        context = run.steps.context[:, run.steps.space.context_names.index(name)]
        known, changes = context[np.isfinite(context)], np.abs(np.diff(context, prepend=np.nan))[run.steps.follows]
        if not len(known):
            continue
        above = listed([each.name for each in run.space.state if each.above == name])
        unit = next(f" {each.unit}" for each in names if each.name == name)
        found.append(
            f"{capitalised(above)} is measured above the {name} that each step found, which lay between "
            f"{decimal(known.min(), 2)} and {decimal(known.max(), 2)}{unit} and changed by up to "
            f"{decimal(np.nanmax(np.append(changes, 0.0)), 2)}{unit} from a step to the next."
        )
    return found


def _limits(run: Run) -> list[str]:
    """Sentences on cut commands, and on targets that were not held."""
    if not run.deployments:
        return []
    first, last = run.deployments[0], run.deployments[-1]
    found = []
    if last.cut:
        learned = "; the residual includes what they removed" if last.residual != "none" else ""
        found.append(f"Limits cut {last.cut} of {last.steps} commands of deployment {last.iteration}{learned}.")
    of_first = "nominal map" if first.residual == "none" else f"map of deployment {first.iteration}"
    for of_map, entry in {of_first: first, f"map of deployment {last.iteration}": last}.items():
        if len(entry.unreachable):
            found.append(
                f"Not held by any command within the bounds, by the {of_map}: {_targets(run, entry.unreachable)}."
            )
    if len(last.missed):
        found.append(
            f"Missed in deployment {last.iteration}, with a steady error above {TRACKED:g} times the scatter of its "
            f"steady steps, although its map holds them: {_targets(run, last.missed)}."
        )
    return found


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
    found = Counter(logged.record.status for logged in run.steps)
    falls, stops = found[StepStatus.FELL], found[StepStatus.STOPPED]
    doubts = found[StepStatus.DOUBTFUL]
    others = run.steps.failed_steps - falls - stops - doubts
    parts = [
        *([_count(falls, "fall")] if falls or not run.steps.failed_steps else []),
        *([f"{_count(stops, 'step')} stopped by the plant"] if stops else []),
        *([f"{_count(doubts, 'step')} stopped because of a doubtful sensor"] if doubts else []),
        *([f"{_count(others, 'step')} without a next state for other reasons"] if others else []),
    ]
    return ", ".join(parts)
