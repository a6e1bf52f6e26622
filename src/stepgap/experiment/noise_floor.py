"""The noise floor of a simulated plant: the standard deviation of the next state when a step is repeated.

A controller that knows neither the noise nor the phase cannot track better on average. A controller that learns what
returns with the phase (`learning.drift`) can, but not better than the standard deviation at one phase.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
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

SETTLING = 3
"""Number of steps from the start towards a target before the repeated one. The hopper and the quadruped are at their
noise floor after two and three."""

PHASES = 4
"""Number of phases of the periodic context, such as angles on a circle, at which a step is repeated. The 95 % interval
of the floor then ends some 15 % above its value, with 6 phases 12 %, for a third more time; 25 % instead of 15 % where
the phase matters much more than the noise."""

REPEATS = 2  # Number of repetitions at each phase, which differ in noise only

MakePlant = Callable[[np.random.Generator], RepeatablePlant | None]
"""Makes a plant that draws everything random from a generator; None where no plant can repeat a step."""

EXACT = ControlSettings(cautious=False, viability=False, avoid_failures=False, evaluations=10**6)
"""Settings with which Eq. 13 is solved as it is: no rule restricts the command, and no budget the search."""


def measure_noise_floor(
    make_plant: MakePlant,
    step_map: StepMap,
    reference: Reference,
    rng: np.random.Generator,
    progress: Callable[[int, int], None] = lambda done, total: None,
    threads: int = 1,
) -> NoiseFloor:
    """Pooled standard deviations of the next state when a plant repeats a step [state units].

    Each target has a plant and a random stream of its own, so the result is the same with any number of threads.

    The repetitions have the same command, the same true motion at the beginning of the step, and the same memory of the
    control, hence the same measured state. The noise, including its present value, is drawn again for each of them. The
    phase is drawn again for every second one: the world is turned by a random angle, because the phase is not part of
    the state. The variances within and between the phases are the components of a one-way
    analysis of variance with random effects (Searle, Casella, McCulloch, Variance Components, ch. 3).

    Args:
        make_plant: Makes the plant of a target.
        step_map: Map whose commands lead to the targets by Eq. 13, without the rules of a deployment, and each found
            from the middle of the bounds.
        reference: Reference whose targets are held.
        rng: Its children draw the noise of the plants, and the phase of the repeated steps.
        progress: Called with the numbers of finished and of all targets.
        threads: Number of targets that are measured at once.

    Returns:
        NaN where no step could be repeated at two phases, and where states are measured above a ground: at another
        phase it would be another one.
    """
    if step_map.space.is_above_context:
        return NoiseFloor.unknown(len(reference.names))
    starts = np.unique([0, *reference.changes])
    chosen = starts[np.unique(np.linspace(0, len(starts) - 1, REPEATED_TARGETS).round().astype(int))]
    size = len(reference.names)
    groups = list[Array]()
    no_failures = np.empty((0, size + len(step_map.space.command)))
    repeated = partial(_repeated, make_plant, CautiousController(step_map, step_map, no_failures, EXACT))
    jobs = zip(reference.targets[chosen], rng.spawn(len(chosen)), strict=True)
    progress(0, len(chosen))
    for states in _side_by_side(repeated, jobs, threads):
        groups.append(states)
        progress(len(groups), len(chosen))
    return _pooled(groups, size)


def _side_by_side(
    repeated: Callable[[tuple[Array, np.random.Generator]], Array],
    jobs: Iterable[tuple[Array, np.random.Generator]],
    threads: int,
) -> Iterator[Array]:
    """Repeated steps of one target after another; if the caller stops, threads end with the target they are at."""
    if threads == 1:  # not in a thread, since a plant of somebody's own may need the main one
        yield from map(repeated, jobs)
        return
    pool = ThreadPoolExecutor(threads)
    try:
        yield from pool.map(repeated, jobs)
    finally:
        pool.shutdown(cancel_futures=True)


def _repeated(make_plant: MakePlant, controller: CautiousController, job: tuple[Array, np.random.Generator]) -> Array:
    """Next states of a step that is repeated at a target; shape (phases, repeats, n), no phases where steps fail."""
    target, rng = job
    nothing = np.empty((0, REPEATS, len(controller.step_map.space.state)))
    plant = make_plant(rng)
    if plant is None:
        return nothing
    with plant:
        state = plant.start()
        for _ in range(SETTLING):
            record = plant.take_step(tracking_plan(controller, state, target, None).command)
            state = record.next_state
            if record.status != StepStatus.OK:
                return nothing
        command = tracking_plan(controller, state, target, None).command
        phases = rng.uniform(0, tau, PHASES)
        states = np.array([[plant.repeated(command, rng, phase) for _ in range(REPEATS)] for phase in phases])
    return states[np.isfinite(states).all(axis=(1, 2))]


def _pooled(groups: Sequence[Array], size: int) -> NoiseFloor:
    """Components of variance of repeated steps (phases, repeats, n), one array for each target; n is the `size`."""
    groups = [group for group in groups if len(group) > 1]
    if not groups:
        return NoiseFloor.unknown(size)
    means = [group.mean(axis=1) for group in groups]
    within = np.array([np.sum((x - m[:, None]) ** 2, axis=(0, 1)) for x, m in zip(groups, means, strict=True)])
    between = np.array([REPEATS * np.sum((m - m.mean(axis=0)) ** 2, axis=0) for m in means])
    counts = np.array([len(group) for group in groups])
    within_freedom = counts * (REPEATS - 1)
    between_freedom = counts - 1
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
