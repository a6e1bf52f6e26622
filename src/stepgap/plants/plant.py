"""The interface of a plant, which executes steps."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from stepgap.step import Array, StepRecord, StepSpace


@dataclass(frozen=True, eq=False)
class Touchdown:
    """What is measured within a step while a new command may still act, as when a foot touches down.

    Attributes:
        state: State at the start of the step, above what was found now where that is so declared; shape (n,).
        context: Context of the step by name, as far as it is known.
    """

    state: Array
    context: Mapping[str, float]


AtTouchdown = Callable[[Touchdown], Array]
"""Chooses the command of a step anew at its touchdown; shape (m,)."""


class StepCommands:
    """The commands that were given for a step, the first one and that of its touchdown, checked alike by all plants.

    Args:
        first: Command before the step; shape (m,).
    """

    def __init__(self, space: StepSpace, first: Array):
        self._space = space
        self._given = [np.asarray(first, float)]

    @property
    def first(self) -> Array:
        """The command before the step; shape (m,)."""
        return self._given[0]

    @property
    def within(self) -> Array:
        """The latest command within its bounds; shape (m,)."""
        return self._limited(self._given[-1])

    def replace(self, choose: AtTouchdown, touchdown: Touchdown) -> Array:
        """Asks for another command, once per step; the present one stays if that is not m finite numbers.

        Returns:
            The command within its bounds; shape (m,).
        """
        if len(self._given) == 1:
            command = np.asarray(choose(touchdown), float)
            if command.shape == self._given[0].shape and np.isfinite(command).all():
                self._given.append(command)
        return self.within

    def acted(self, requested: Array) -> Array:
        """The given command that is nearest to the one that acted within its bounds; shape (m,)."""
        newest_first = self._given[::-1]  # of equally near ones, the newest
        distances = [float(np.abs(self._limited(command) - requested).sum()) for command in newest_first]
        return newest_first[int(np.argmin(np.nan_to_num(distances, nan=np.inf)))]

    def _limited(self, command: Array) -> Array:
        return np.clip(command, self._space.command_lower, self._space.command_upper)


class Plant(ABC):
    """Executes steps, one deployment at a time.

    Use it as a context manager, which stops it in every case; inside, `start` returns the first state at the
    section (of a hopper, the apex), and `take_step` runs from there to the next.
    """

    @property
    @abstractmethod
    def space(self) -> StepSpace:
        """Names, units and ranges of its states and commands."""

    @property
    def fault(self) -> str:
        """Why the last deployment was aborted, if the plant knows more than the status of the step; else empty."""
        return ""

    @property
    def first_step(self) -> StepRecord | None:
        """The step that ended at the first state, if it began at a section like any other; else None.

        Known after `start`. A robot that is held at rest in the air and then released has begun it at an apex; one that
        is lowered to the ground by hand has not.
        """
        return None

    @abstractmethod
    def start(self) -> Array:
        """Releases the robot and returns its first state at the section; shape (n,)."""

    @abstractmethod
    def take_step(self, command: Array) -> StepRecord:
        """Executes one step with the command; shape (m,).

        A failed step is a record whose status is not OK, after which the deployment is over.
        """

    def take_replanned_step(self, command: Array, at_touchdown: AtTouchdown) -> StepRecord:  # noqa: ARG002
        """As `take_step`, but the command may be chosen anew at the touchdown within the step.

        Args:
            command: Command of the step if no other comes in time; shape (m,).
            at_touchdown: Called with what was measured there. The record has the command that acted. Plants without
                such an event never call it.
        """
        return self.take_step(command)

    @abstractmethod
    def stop(self) -> None:
        """Brings the robot to rest and switches torque off; may be called twice."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.stop()


class RepeatablePlant(Plant):
    """A simulated plant that can repeat a step, which shows how much the next state varies by itself."""

    @abstractmethod
    def repeated(self, command: Array, rng: np.random.Generator, turned: float = 0.0) -> Array:
        """Next state of a copy of the plant that takes a step with new noise; the plant itself stays where it is.

        Args:
            command: Command of the step; shape (m,).
            turned: Angle by which the world is turned under the copy [rad], if that has an effect.
        """
