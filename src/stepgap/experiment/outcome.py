"""The outcome of a deployment: errors, noise floor, cut commands, targets not held, and states that are far off."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from stepgap.control.limit_cycle import reached_in_one_step
from stepgap.control.reach import whole_states
from stepgap.control.reference import Reference, mean_of_known, same_target
from stepgap.learning.alarm import Alarm
from stepgap.learning.steps import Steps
from stepgap.records.summary import Deployment, NoiseFloor
from stepgap.records.text import decimal, unit_suffix
from stepgap.step import Array, StepMap

CUT = 0.01  # A command counts as cut by limits if they remove more than this part of its half range
TRACKED = 3.0  # An error of at most this number of noise floors counts as tracking

NEARLY_ZERO = 1e-3
"""An error of at most this part of half a range of use counts as tracking, too: of a plant without noise."""


def summarise(
    steps: Steps,
    reference: Reference,
    residual: str,
    step_map: StepMap | None = None,
    floor: Array | None = None,
    alarms: tuple[Alarm, ...] = (),
) -> Deployment:
    """Outcome of the steps of one deployment.

    Args:
        steps: The steps; the first one of a plant, which had no target, does not count.
        reference: Reference that was tracked.
        residual: Name of the residual that was used.
        step_map: Map with which the deployment began. Without it, no target counts as unreachable.
        floor: Noise floor as `estimate_noise_floor` found it in these steps; by default it is estimated here.
        alarms: Those of the deployment.
    """
    tracked = steps.completed().tracking()
    numbers = tracked.number - 1
    error = tracked.next_state - tracked.target
    true_error = tracked.true_next_state - tracked.target
    unreachable = unreachable_targets(step_map, reference) if step_map else np.empty((0, error.shape[1]))

    floor = estimate_noise_floor(steps, reference).any_phase if floor is None else floor

    return Deployment(
        iteration=steps.iterations[0],
        residual=residual,
        steps=len(steps.planned()),
        failed_steps=steps.failed_steps,
        rmse=np.sqrt(mean_of_known(error**2)),
        mae=mean_of_known(np.abs(error)),
        bias=mean_of_known(error),
        steady_rmse=np.sqrt(mean_of_known(error[np.isin(numbers, reference.steady)] ** 2)),
        transient_rmse=np.sqrt(mean_of_known(error[np.isin(numbers, reference.transient)] ** 2)),
        true_rmse=np.sqrt(mean_of_known(true_error**2)),
        cut=count_cut(steps.planned()),
        unreachable=unreachable,
        missed=missed_targets(steps, reference, unreachable, floor),
        alarms=alarms,
    )


def estimate_noise_floor(steps: Steps, reference: Reference) -> NoiseFloor:
    """Noise floor estimated from the steady steps of one deployment [state units]; that at one phase is not known.

    It is the residual standard error of a linear fit of the next state in state and command. Where the map is not
    linear, it is larger than the true noise. NaN where the steps are too few.
    """
    steady = _steady(steps, reference)
    inputs = np.hstack([np.ones((len(steady), 1)), steady.state, steady.requested])
    degrees_of_freedom = len(steady) - inputs.shape[1]
    if degrees_of_freedom < 1:
        return NoiseFloor.unknown(len(steps.space.state))
    fitted = inputs @ np.linalg.lstsq(inputs, steady.next_state, rcond=None)[0]
    floor = np.sqrt(np.sum((steady.next_state - fitted) ** 2, axis=0) / degrees_of_freedom)
    return NoiseFloor(floor, np.full_like(floor, np.nan), float(degrees_of_freedom), steps=len(steady))


def cut_commands(steps: Steps) -> np.ndarray:
    """Whether limits removed more than `CUT` of each requested command; shape (N, m)."""
    return np.abs(steps.requested - steps.applied) / steps.space.command_scale > CUT


def count_cut(steps: Steps) -> int:
    """Number of steps of whose requested command the limits removed more than `CUT`."""
    return int(cut_commands(steps).any(axis=1).sum())


def unreachable_targets(step_map: StepMap, reference: Reference) -> Array:
    """Distinct targets that no command holds according to a map, in ascending order; shape (k, n)."""
    return reference.targets[unheld_steps(step_map, reference)]


def unheld_steps(step_map: StepMap, reference: Reference) -> NDArray[np.intp]:
    """First step, from 0 on, with each distinct target that no command holds according to a map; shape (k,)."""
    first, _ = reference.distinct
    targets = reference.targets[first]
    return first[~reached_in_one_step(step_map, whole_states(step_map, targets), targets)]


def missed_targets(steps: Steps, reference: Reference, unreachable: Array, floor: Array) -> Array:
    """Distinct targets that were missed although they are reachable; shape (k, n).

    A target is missed if the RMSE of the steady steps with this target exceeds `TRACKED` noise floors (n,) in some
    coordinate, and `NEARLY_ZERO` half ranges.
    """
    steady = _steady(steps, reference)
    missed = []
    limit = np.maximum(TRACKED * floor, NEARLY_ZERO * steps.space.state_scale)
    for target in reference.targets[reference.distinct[0]]:
        here = same_target(steady.target, target)
        rmse = np.sqrt(mean_of_known((steady.next_state[here] - target) ** 2))
        if (rmse > limit).any() and not same_target(unreachable, target).any():
            missed.append(target)
    return np.array(missed).reshape(-1, len(reference.names))


def _steady(steps: Steps, reference: Reference) -> Steps:
    """The steady steps of a deployment that ended at their section."""
    done = steps.completed()
    return done.selected(np.isin(done.number, reference.steady + 1))


COMPARED_STEPS = 5
"""Number of steps of a deployment, at most, whose states are compared with the ranges of use."""

FAR_RANGES = 3.0
"""A state is far outside its range of use if it is more than this number of widths of the range away from it."""

FEWEST_OFFSET = 5  # Smallest number of steps that show that a coordinate stays away from its targets
FAR_OFFSET = 2.0  # Smallest ratio of a mean error to its scatter that is called an offset


def far_states(steps: Steps) -> Iterable[str]:
    """A sentence for each state coordinate that is far outside its range of use.

    A coordinate is reported if the median of its distance from its range of use, over the first `COMPARED_STEPS` steps,
    is more than `FAR_RANGES` widths of that range. A robot that works hardly ever is, but degrees, millimetres or
    interchanged coordinates are.

    Args:
        steps: Steps of one deployment, in the order in which they were executed.
    """
    states = steps.state[:COMPARED_STEPS]
    if not len(states):
        return
    when = f"In the first {len(states)} steps" if len(states) > 1 else "In the first step"
    for quantity, values in zip(steps.space.state, states.T, strict=True):
        beyond = np.maximum(quantity.lower - values, values - quantity.upper) / (quantity.upper - quantity.lower)
        if np.median(beyond) > FAR_RANGES:
            middle = values[np.argsort(beyond)[len(values) // 2]]
            yield (
                f"{when} of deployment {steps.iterations[0]}, {quantity.name} was about {middle:.4g}, but its range of "
                f"use is {quantity.lower:g} to {quantity.upper:g} {quantity.unit or '(no unit)'}: check the unit in "
                "which the plant gives it, and the range."
            )


def offset_sentences(deployment: Steps) -> list[str]:
    """Sentences on coordinates that ended on the same side of all their targets, far away, in a deployment.

    Before anything was learned, that is an error of the nominal map unless it is larger than half the range of use.
    """
    steps = deployment.tracking().completed()
    if len(steps) < FEWEST_OFFSET:
        return []
    sentences = []
    for row, quantity in enumerate(steps.space.state):
        error = steps.tracking_errors()[:, row]
        ends = steps.next_state[:, row]
        unit = unit_suffix(quantity)
        low = error.min()
        high = error.max()
        apart = ends.max() < steps.target[:, row].min() or ends.min() > steps.target[:, row].max()
        if low * high <= 0 or not apart or abs(error.mean()) < FAR_OFFSET * error.std():
            continue
        if not steps.std.any() and abs(error.mean()) < steps.space.state_scale[row]:
            continue
        side, least, most = ("above", low, high) if low > 0 else ("below", -high, -low)
        sentences.append(
            f"In all {len(steps)} steps of deployment {steps.iterations[0]}, {quantity.name} ended {side} all targets, "
            f"{decimal(least)} to {decimal(most)}{unit} from its own."
        )
    return sentences
