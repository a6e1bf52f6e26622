"""The outcome of a deployment: tracking errors, noise floor, cut commands, and targets that it did not hold."""

import numpy as np
from numpy.typing import NDArray

from stepgap.control.reach import reached_in_one_step, whole_states
from stepgap.control.reference import Reference, mean_of_known, same_target
from stepgap.learning.alarm import Alarm
from stepgap.learning.steps import Steps
from stepgap.records.summary import Deployment, NoiseFloor
from stepgap.step import Array, StepMap

CUT = 0.01
"""A command counts as cut by limits if they remove more than this part of its half range."""

TRACKED = 3.0
"""An error of at most this number of noise floors counts as tracking."""

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
    error, true_error = tracked.next_state - tracked.target, tracked.true_next_state - tracked.target
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
    steady, missed = _steady(steps, reference), []
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
