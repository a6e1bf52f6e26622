"""Errors of the nominal map on simulated robots that differ from their model in a few ways, on all cores."""

import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, final

import numpy as np

from stepgap.base.blas import one_blas_thread
from stepgap.base.errors import InputError
from stepgap.base.random_streams import random_stream
from stepgap.base.start_method import process_context, usable_cores
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import deploy
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import Experiment
from stepgap.gauss.monomials import number_of_monomials
from stepgap.learning.learner import Learner
from stepgap.learning.observations import Observations, observe
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.rigs.rig import RigFault
from stepgap.robots.entry_points import simulations_of
from stepgap.robots.gap import Gap
from stepgap.robots.robot import Robot
from stepgap.step import Array, StepMap
from stepgap.study.explanation import SIGNATURE_DEGREE, Cause, Shares, Simulate, Surface, causes_of, fit_surface

STEPS_PER_MONOMIAL: Final = 8  # Number of simulated steps for each monomial of the polynomials
MOST_SIMULATED_STEPS: Final = 240  # Largest number of simulated steps of a robot
MOST_FALLS: Final = 3  # How often a robot that falls starts again

LEARNING: Final = LearningSettings(residual="constant", online=True)
"""How a simulated robot learns, so that it visits the states of the run."""

JITTER: Final = 0.05  # Standard deviation by which targets differ from states of the run [half ranges]


@final
@dataclass(frozen=True, eq=False)
class SimulatedRobots:
    """Robots of an experiment that track states of a run.

    Attributes:
        settings: Settings of the experiment, with a robot that has a gap.
        targets: States to track, about which the simulations of each number have targets of their own; NaN where they
            are not tracked; shape (N, n).
        seed: Random seed of the simulations, which are without noise unless that is known or a cause.
        known: Differences that the robot certainly has, such as the resolution of its encoders, with their values.
    """

    settings: Experiment
    targets: Array
    seed: int = 0
    known: Mapping[str, float] = field(default_factory=dict[str, float])

    @cached_property
    def nominal(self) -> StepMap:
        """The nominal map."""
        return load_nominal(self.settings).map

    @cached_property
    def causes(self) -> Mapping[str, Cause]:
        """The differences that the robot may have, by name."""
        return {cause.name: cause for cause in causes_of(gap_of(self.settings))}

    def steps(self, shares: Shares, number: int) -> Observations | None:
        """Errors of a robot with causes of some sizes; None if it does not walk, or a size is not valid.

        Args:
            shares: The sizes.
            number: Number by which targets and noise scatter.
        """
        values: dict[str, Any] = {name: self.causes[name].value(share) for name, share in shares.items()}
        try:
            gap = replace(type(gap_of(self.settings)).none(), **{**self.known, **values})
        except ValueError:
            return None
        robot = with_gap(self.settings.robot, gap)
        space = self.nominal.space
        log = Steps(space)
        targets = self._targets(random_stream(self.seed, number, 0))
        with one_blas_thread():
            simulation = next(iter(simulations_of(robot).values()))(random_stream(self.seed, number, 1))
            for attempt in range(MOST_FALLS):
                if len(log) >= len(targets):
                    break
                reference = Reference(space.state_names, targets[len(log) :]).of(space)
                learner = Learner.start(self.nominal, log, LEARNING, attempt)
                plant = simulation.plant(random_stream(self.seed, number, 2 + attempt))
                with closing(deploy(learner, plant, reference, attempt)) as executed:
                    try:
                        for logged in executed:
                            log += [logged]
                    except RigFault:
                        continue
            completed = observe(log.completed(), self.nominal)
        return completed if len(completed) > len(targets) // 2 else None

    def _targets(self, rng: np.random.Generator) -> Array:
        space = self.nominal.space
        scaled = space.scaled_state(self.targets) + JITTER * rng.standard_normal(self.targets.shape)
        return space.state_centre + np.clip(scaled, -1, 1) * space.state_scale

    def surface(self, shares: Shares, number: int) -> Surface | None:
        """The error of such a robot."""
        steps = self.steps(shares, number)
        return None if steps is None else fit_surface(steps)


def with_gap(robot: Robot, gap: Gap) -> Robot:
    """A robot with another gap."""
    changed: Any = robot  # a frozen dataclass, which the type of its abstract class does not say
    return replace(changed, gap=gap)


def gap_of(settings: Experiment) -> Gap:
    """The gap of the robot of an experiment.

    Raises:
        InputError: It has none.
    """
    gap = getattr(settings.robot, "gap", None)
    if not isinstance(gap, Gap) or not causes_of(gap):
        raise InputError(
            f"robot '{settings.robot.name}': its simulated plant has no differences from the model that could be "
            "causes; its table gap must be a Gap (stepgap.robots.gap)"
        )
    return gap


def targets_of(run: Observations) -> Array:
    """States of a run, in their order, that simulated robots track; NaN where they are not tracked; shape (N, n)."""
    monomials = number_of_monomials(len(run.space.names), SIGNATURE_DEGREE)
    count = min(STEPS_PER_MONOMIAL * monomials, MOST_SIMULATED_STEPS)
    rows = np.linspace(0, len(run) - 1, count).round().astype(int)
    return np.where(run.space.tracked, run.state[rows], np.nan)


_kept: list[SimulatedRobots] = []
"""The robots of this process of the pool, whose nominal map is made once."""


def _keep_robots(robots: SimulatedRobots) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits
    _kept[:] = [robots]


def _surface(shares: Shares, number: int) -> Surface | None:
    return _kept[0].surface(shares, number)


@contextmanager
def simulated_on_all_cores(robots: SimulatedRobots, progress: Callable[[int], None]) -> Iterator[Simulate]:
    """The function that simulates robots, in as many processes as there are cores.

    Args:
        progress: Called with the number of robots that have been simulated.
    """
    done = 0
    pool = ProcessPoolExecutor(usable_cores(), process_context(), _keep_robots, (robots,))

    def simulate(requests: Sequence[tuple[Shares, int]]) -> list[Surface | None]:
        nonlocal done
        futures = [pool.submit(_surface, shares, number) for shares, number in requests]
        for _ in as_completed(futures):
            done += 1
            progress(done)
        return [future.result() for future in futures]

    try:
        yield simulate
    finally:
        pool.shutdown(cancel_futures=True)  # after Ctrl-C no further robot is simulated
