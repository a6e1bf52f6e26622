"""The results of a run in sentences."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from stepgap.experiment.bands import rmse_interval
from stepgap.experiment.outcome import TRACKED
from stepgap.experiment.run import Run
from stepgap.records.summary import Deployment
from stepgap.report.text import between, capitalised, decimal, unit_suffix
from stepgap.robots.published_result import PublishedResult
from stepgap.step import Array, StepStatus, ending_of

MOST_NAMED = 6
"""Largest number of targets that a sentence names."""


def headline(run: Run) -> str:
    """Sentence on whether the run tracked its reference."""
    if not run.deployments:
        return "No deployment is finished yet."
    first, last = run.deployments[0], run.deployments[-1]
    if last.failed_steps:
        return f"It did not track to the end: {_ended(run, last)}."
    to_end = f"the last deployment made all its {_count(last.steps, 'step')} without a fall"
    if first is last:
        return f"One deployment so far, so there is nothing to compare with: {to_end}."
    far = _beyond_noise(run, last)
    verdict = f"It did not track: {far}. But {to_end}" if far else f"It tracked: {to_end}"
    if (last.errors["rmse"] < first.errors["rmse"]).all():
        return f"{verdict}, and every tracking error is smaller than in deployment {first.iteration}."
    if first.failed_steps:
        return f"{verdict}, whereas {_ended(run, first)}."
    if np.isnan(last.errors["rmse"] - first.errors["rmse"]).any():
        return f"No fall, but not every tracking error is known: {to_end}."
    return f"No fall, but not better in every coordinate: {to_end}."


def sentences(run: Run) -> list[str]:
    """Sentences on errors, failed steps and unfinished deployments, and the published result for the same reference."""
    found = []
    if len(run.deployments) > 1:
        found += [_change(run, row) for row in range(len(run.space.state))]
    found += [
        f"{capitalised(_ended(run, deployment))}; its errors include only the steps before."
        for deployment in run.deployments
        if deployment.failed_steps
    ]
    found += _floor(run)
    found += _limits(run)
    found.append(
        f"{_count(len(run.steps), 'step')} recorded in {_count(len(run.steps.iterations), 'deployment')} "
        f"on the {run.plant}, {_failures(run)}."
    )
    found += [
        f"Deployment {iteration} is running or was interrupted: "
        f"its {_count(steps, 'step')} so far are not included in the errors."
        for iteration, steps in run.unfinished.items()
    ]
    if theirs := run.compared_result:
        found.append(_published(theirs))
    return found


def improvement(first: Deployment, last: Deployment, measure: str) -> Array:
    """Factor by which an error decreased, NaN where unknown; shape (n,)."""
    before, after = first.errors[measure], last.errors[measure]
    return np.divide(before, after, out=np.full(len(before), np.nan), where=(before > 0) & (after > 0))


def _change(run: Run, row: int) -> str:
    """Sentence on the errors of one state coordinate in the first and the last deployment."""
    first, last, quantity = run.deployments[0], run.deployments[-1], run.space.state[row]
    interval, parts = rmse_interval(run.steps.of_iteration(last.iteration))[:, row], []
    for measure in ("rmse", "mae"):
        before, after = first.errors[measure][row], last.errors[measure][row]
        factor = improvement(first, last, measure)[row]
        outcome = f", {_times(factor)}" if np.isfinite(factor) else ""
        known = f"from {decimal(before)} to {decimal(after)}{unit_suffix(quantity)}{outcome}"
        parts.append(f"{measure.upper()} {known if np.isfinite(before - after) else 'unknown'}")
    if np.isfinite([*interval, last.errors["rmse"][row]]).all():
        ends = f"{decimal(interval[0])} to {decimal(interval[1])}{unit_suffix(quantity)}"
        parts.insert(1, f"95 % interval of the last RMSE {ends}")
    title = capitalised(quantity.name.replace("_", " "))
    return f"{title}, from deployment {first.iteration} to {last.iteration}: {'; '.join(parts)}."


def _times(factor: float) -> str:
    if factor >= 1:
        return f"{decimal(factor, 2)} times smaller"
    return f"{decimal(1 / factor, 2)} times larger"


def _floor(run: Run) -> list[str]:
    """Sentence on the noise floor of the plant, and on the ratio of the last errors to it."""
    known = [row for row, value in enumerate(run.noise_floor) if value > 0]
    if not known:
        return []
    state, floor = run.space.state, run.noise_floor
    values = _with_intervals(run, floor, run.noise_floor_interval, known)
    count = f"from {_count(run.noise_floor_steps, 'step')}, " if run.noise_floor_steps else ""
    errors = run.deployments[-1].errors["steady_rmse"]
    ratios = ", ".join(f"{decimal(errors[row] / floor[row], 2)} times that in {state[row].name}" for row in known)
    how = (
        f"is {values}, {count}measured with the same command and the same motion at the start, but "
        f"{_differences(run, known)}"
        if run.summary.noise_floor_measured
        else f"is at most about {values}, {count}the residual standard error of a linear fit to the steady steps of "
        "the last deployment; the true noise floor may be smaller"
    )
    compared = f" The last steady RMSE is {ratios}." if np.isfinite([errors[row] for row in known]).all() else ""
    return [f"The noise floor (standard deviation of repeated steps) {how}.{compared}"]


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
        "cannot have smaller steady errors on average. One that estimates the periodic disturbance (learning.drift) "
        f"can, but not smaller than the noise alone: {alone}"
    )


def _with_intervals(run: Run, floor: Array, ends: Array, rows: Sequence[int]) -> str:
    """Standard deviations (n,) of some coordinates, with their intervals (2, n) where these are known."""
    state = run.space.state
    return ", ".join(
        f"{state[row].name} {decimal(floor[row])}{unit_suffix(state[row])}{between(ends[:, row])}" for row in rows
    )


def _beyond_noise(run: Run, deployment: Deployment) -> str:
    """Phrase on the errors of a deployment that exceed three noise floors; empty if there are none."""
    ratios = deployment.errors["rmse"] / np.where(run.noise_floor > 0, run.noise_floor, np.nan)
    large = [row for row, ratio in enumerate(ratios) if ratio > TRACKED]
    named = [f"the error of {run.space.state[row].name} is {decimal(ratios[row], 2)} noise floors" for row in large]
    return " and ".join(named)


def _limits(run: Run) -> list[str]:
    """Sentences on cut commands, and on targets that were not held."""
    if not run.deployments:
        return []
    first, last = run.deployments[0], run.deployments[-1]
    found = []
    if last.cut:
        found.append(
            f"Limits cut {last.cut} of {last.steps} commands of deployment {last.iteration}; the residual includes "
            "what they removed."
        )
    for of_map, entry in {"nominal map": first, f"map of deployment {last.iteration}": last}.items():
        if len(entry.unreachable):
            found.append(f"Unreachable according to the {of_map}: {_targets(run, entry.unreachable)}.")
    if len(last.missed):
        found.append(
            f"Missed in deployment {last.iteration}, with a steady error above {TRACKED:g} noise floors, although "
            f"reachable according to the map: {_targets(run, last.missed)}."
        )
    return found


def _targets(run: Run, targets: Array) -> str:
    """Targets with their units."""
    count = _count(len(targets), "target")
    texts = [
        " ".join(f"{value:.4g}{unit_suffix(quantity)}" for value, quantity in zip(target, run.space.state, strict=True))
        for target in targets[:MOST_NAMED]
    ]
    more = f"; and {len(targets) - MOST_NAMED} more" if len(targets) > MOST_NAMED else ""
    return f"{count} ({'; '.join(texts)}{more})"


def _published(result: PublishedResult) -> str:
    ratios = result.errors[0]["rmse"] / result.band
    factors = [f"{ratio:.1f} in {name}" for name, ratio in zip(result.reference.names, ratios, strict=True)]
    return (
        f"For comparison: on {result.source}'s hardware the RMSE decreased by a factor of {' and '.join(factors)} with "
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
