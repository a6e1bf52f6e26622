"""Simulated steps of a robot: half of them all over the ranges of use, half of them along motions.

In many dimensions nearly all of a box of ranges is far from any gait. So half of the steps begin where an earlier step
ended within the ranges, and have random commands within the bounds: the motions branch like a tree (LaValle and
Kuffner, Randomized kinodynamic planning, 2001, without a goal). A motion ends where a step fails or leaves the ranges;
others go on from the states that were visited before. The other half begin in states that random commands seldom lead
to, but a controller may.

In a walker with four states, both halves together predict steps along motions better than either one alone; commands
with growing amplitude about the middle of their bounds are worse (docs/mujoco_robot.md has the numbers).
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple, final

import numpy as np

from stepgap.step import Array, Codes, Outcome, StepMap, StepSpace, StepStatus

WIDENED: Final = 1.25
"""Half the sampled range of a state in half ranges of use, because a robot leaves these at times."""

GENERATION: Final = 32  # Number of steps that are computed before the states in which they end are known
SAMPLE_PARTS: Final = 16  # Number of parts in which steps are computed, at most

MapFunction = Callable[..., Iterable[Outcome]]
"""The function `map`, or that of an executor."""


class Samples(NamedTuple):
    """Simulated steps.

    Attributes:
        points: Scaled states and commands, in −1 … 1; shape (N, d).
        next_state: NaN where a step failed; shape (N, n).
        status: `StepStatus` values; shape (N,).
    """

    points: Array
    next_state: Array
    status: Codes

    def plus(self, more: "Samples") -> "Samples":
        """These and more."""
        return Samples(
            np.concatenate([self.points, more.points]),
            np.concatenate([self.next_state, more.next_state]),
            np.concatenate([self.status, more.status]),
        )


@final
@dataclass(frozen=True, eq=False)
class Motions:
    """Motions of a map under random commands; each call draws further numbers.

    Attributes:
        step_map: The map.
        rng: Scrambles the Sobol sequences, and draws the states from which motions go on.
        mapped: How parts of the steps are computed.
    """

    step_map: StepMap
    rng: np.random.Generator
    mapped: MapFunction = map

    @property
    def space(self) -> StepSpace:
        """State and command."""
        return self.step_map.space

    @cached_property
    def centre(self) -> Array:
        """Middle of the sampled range of states and commands; shape (d,), d = n + m."""
        return np.concatenate([self.space.state_centre, self.space.command_centre])

    @cached_property
    def scale(self) -> Array:
        """Half that range; shape (d,)."""
        return np.concatenate([WIDENED * self.space.state_scale, self.space.command_scale])

    def begun(self, count: int) -> Samples:
        """First steps of motions, all over the ranges of states and commands."""
        return self._stepped(2 * self._everywhere.random(count) - 1)

    def continued(self, samples: Samples, count: int) -> Samples:
        """These steps and an even number of further ones, half of them first steps; all, if no step stays in range."""
        n = len(self.space.state)
        commands = 2 * self._commands.random(count // 2) - 1
        samples = samples.plus(self.begun(count // 2))
        for rows in np.split(commands, range(GENERATION, len(commands), GENERATION)):
            ends = (samples.next_state[samples.status == StepStatus.OK] - self.centre[:n]) / self.scale[:n]
            ends = ends[np.all(np.abs(ends) <= 1, axis=1)]
            if not len(ends):
                return samples.plus(self.begun(count // 2))
            states = ends[self.rng.integers(len(ends), size=len(rows))]
            samples = samples.plus(self._stepped(np.hstack([states, rows])))
        return samples

    @cached_property
    def _everywhere(self) -> Any:
        """The sequence of points all over the ranges of states and commands."""
        return _sobol(len(self.centre), self.rng)

    @cached_property
    def _commands(self) -> Any:
        """The sequence of commands along motions."""
        return _sobol(len(self.space.command), self.rng)

    def _stepped(self, points: Array) -> Samples:
        """Steps from scaled points; shape (N, d)."""
        n = len(self.space.state)
        inputs = np.array_split(self.centre + self.scale * points, min(SAMPLE_PARTS, len(points)))
        outcomes = list(
            self.mapped(self.step_map.evaluate, [part[:, :n] for part in inputs], [part[:, n:] for part in inputs])
        )
        return Samples(
            points,
            np.concatenate([outcome.next_state for outcome in outcomes]),
            np.concatenate([outcome.status for outcome in outcomes]),
        )


def _sobol(size: int, rng: np.random.Generator) -> Any:
    from scipy.stats import qmc  # the import takes long, and few robots have a surrogate

    return qmc.Sobol(size, rng=rng)
