"""The noise floor of a simulated plant: the standard deviation of the next state when a step is repeated.

A controller that knows neither the noise nor the phase cannot track better on average. A controller that estimates the
disturbance (`learning.disturbance`) can, but not better than the standard deviation at one phase.
"""

from collections.abc import Callable, Sequence
from math import tau

import numpy as np

from stepgap.control.cautious_controller import CautiousController
from stepgap.control.reference import Reference
from stepgap.control.settings import ControlSettings
from stepgap.experiment.deployment import tracking_plan
from stepgap.plants.plant import RepeatablePlant
from stepgap.records.summary import NoiseFloor
from stepgap.step import Array, StepMap, StepStatus

REPEATED_TARGETS = 20
"""Largest number of targets of the reference at which a step is repeated; they are spread evenly."""

SETTLING = 6
"""Number of steps towards a target before the repeated one."""

PHASES = 6
"""Number of phases of the periodic context, such as angles on a circle, at which a step is repeated."""

REPEATS = 2
"""Number of repetitions at each phase, which differ in noise only."""

EXACT = ControlSettings(cautious=False, viability=False, avoid_failures=False, evaluations=10**6)
"""Settings with which Eq. 13 is solved as it is: no rule restricts the command, and no budget the search."""


def measure_noise_floor(
    plant: RepeatablePlant,
    step_map: StepMap,
    reference: Reference,
    rng: np.random.Generator,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> NoiseFloor:
    """Pooled standard deviations of the next state when a plant repeats a step [state units].

    The repetitions have the same command, the same true motion at the beginning of the step, and the same memory of the
    control, hence the same measured state. The noise, including its present value, is drawn again for each of them. The
    phase is drawn again for every second one: the world is turned by a random angle, because the phase is not part of
    the state. The variances within and between the phases are the components of a one-way
    analysis of variance with random effects (Searle, Casella, McCulloch, Variance Components, ch. 3).

    Args:
        plant: The plant.
        step_map: Map whose commands lead to the targets by Eq. 13, without the rules of a deployment, and each found
            from the middle of the bounds.
        reference: Reference whose targets are held.
        rng: Draws noise and phase of the repeated steps.
        progress: Called with the numbers of finished and of all targets.

    Returns:
        NaN where no step could be repeated at two phases.
    """
    starts = np.unique([0, *reference.changes])
    chosen = starts[np.unique(np.linspace(0, len(starts) - 1, REPEATED_TARGETS).round().astype(int))]
    size, groups = len(reference.names), list[Array]()
    no_failures = np.empty((0, size + len(step_map.space.command)))
    controller = CautiousController(step_map, step_map, no_failures, EXACT)
    with plant:
        state = plant.start()
        for number, target in enumerate(reference.targets[chosen]):
            progress(number, len(chosen))
            for _ in range(SETTLING):
                record = plant.take_step(tracking_plan(controller, state, target, None).command)
                state = record.next_state
                if record.status != StepStatus.OK:
                    return _pooled(groups, size)
            command = tracking_plan(controller, state, target, None).command
            phases = rng.uniform(0, tau, PHASES)
            found = np.array([[plant.repeated(command, rng, phase) for _ in range(REPEATS)] for phase in phases])
            groups.append(found[np.isfinite(found).all(axis=(1, 2))])
    return _pooled(groups, size)


def _pooled(groups: Sequence[Array], size: int) -> NoiseFloor:
    """Components of variance of repeated steps (phases, repeats, n), one array for each target; n is the `size`."""
    groups = [found for found in groups if len(found) > 1]
    if not groups:
        return NoiseFloor.unknown(size)
    means = [found.mean(axis=1) for found in groups]
    within = np.array([np.sum((x - m[:, None]) ** 2, axis=(0, 1)) for x, m in zip(groups, means, strict=True)])
    between = np.array([REPEATS * np.sum((m - m.mean(axis=0)) ** 2, axis=0) for m in means])
    counts = np.array([len(found) for found in groups])
    within_freedom, between_freedom = counts * (REPEATS - 1), counts - 1
    noise = within.sum(axis=0) / within_freedom.sum()
    # The mean square between phases is σ² of the noise + REPEATS · σ² of the phase, which is not negative.
    varies = between.sum(axis=0) / between_freedom.sum() > noise
    shares = np.where(varies, 1 - 1 / REPEATS, 1.0) / within_freedom.sum(), varies / REPEATS / between_freedom.sum()
    terms = [(shares[0] * within, within_freedom), (shares[1] * between, between_freedom)]
    any_phase = np.sum([squares.sum(axis=0) for squares, _ in terms], axis=0)
    freedoms = _effective_freedom(terms), _effective_freedom([(within, within_freedom)])
    return NoiseFloor(np.sqrt(any_phase), np.sqrt(noise), *freedoms, REPEATS * int(counts.sum()))


def _effective_freedom(terms: Sequence[tuple[Array, Array]]) -> Array:
    """Effective degrees of freedom of a sum of weighted sums of squares (Satterthwaite, Biometrics Bulletin 2, 1946).

    The variance may differ from target to target: then the number is smaller. E[s² / (f + 2)] = f σ⁴ for a sum of
    squares s with f degrees of freedom.

    Args:
        terms: Weighted sums of squares by target (g, n), each with its degrees of freedom by target (g,).

    Returns:
        Shape (n,), NaN where all squares are zero.
    """
    total = np.sum([squares.sum(axis=0) for squares, _ in terms], axis=0)
    spread = np.sum([np.sum(squares**2 / (freedom[:, None] + 2), axis=0) for squares, freedom in terms], axis=0)
    return np.divide(total**2, spread, out=np.full_like(total, np.nan), where=spread > 0)
