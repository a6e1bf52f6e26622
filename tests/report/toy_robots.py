"""Robots of some equations, with or without a planted fault, for the tests of `stepgap check`."""

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from stepgap.experiment.settings import Experiment
from stepgap.plants.plant import RepeatablePlant
from stepgap.plants.ticks.stream import OnTicks
from stepgap.robots.robot import Robot, Simulation
from stepgap.step import Array, Outcome, Quantity, StepMap, StepRecord, StepSpace, StepStatus, difference_jacobian

SPEED = Quantity("speed", "m/s", 0.0, 0.8)
HEIGHT = Quantity("height", "m", 0.5, 0.7)
FX = Quantity("fx", "N", -20.0, 20.0)
FY = Quantity("fy", "N", -30.0, 30.0)
HOPPER = StepSpace((SPEED, HEIGHT), (FX, FY))


@dataclass(frozen=True)
class ToyMap(StepMap):
    """A hopper of two equations with a little of everything: couplings, squares and a sine.

    Attributes:
        quantities: Its ranges.
        keep: Speed that is kept.
        push: Speed by fx.
        lift: Height by fy.
        couple: Speed by fy, and height by speed.
        bend: Height by fx².
    """

    quantities: StepSpace = HOPPER
    keep: float = 0.7
    push: float = 0.025
    lift: float = 0.003
    couple: float = 1.0
    bend: float = 2e-5

    @property
    def space(self) -> StepSpace:
        return self.quantities

    def formula(self, state: Array, command: Array) -> Array:
        """Next states."""
        speed, height = state[..., 0], state[..., 1]
        fx, fy = command[..., 0], command[..., 1]
        next_speed = 0.12 + self.keep * speed + self.push * fx + self.couple * 0.003 * fy
        drag = self.couple * 0.05 * speed**2 + self.bend * fx**2
        next_height = 0.6 + 0.5 * (height - 0.6) + self.lift * fy * (1 + 0.005 * fy) - drag + 0.01
        return np.stack(np.broadcast_arrays(next_speed, next_height), axis=-1)

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        state, command = np.asarray(state, float), np.asarray(command, float)
        ends = self.formula(state, command)
        status = np.where(np.isfinite(ends).all(axis=-1), StepStatus.OK, StepStatus.INVALID)
        return Outcome(ends, status.astype(np.int64))

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        return difference_jacobian(self, state, command)


Law = Callable[[StepMap, "Memory", Array, np.random.Generator], Array]
"""Next true state by map, memory, command and random generator."""


@dataclass
class Memory:
    """What a robot is in.

    Attributes:
        state: True state; shape (n,).
        commands: All commands.
        more: What a law keeps.
    """

    state: Array
    commands: list[Array] = field(default_factory=list)
    more: dict[str, Any] = field(default_factory=dict)


def as_mapped(step_map: StepMap, memory: Memory, command: Array, rng: np.random.Generator) -> Array:
    """The law of a robot that is its map."""
    return step_map.evaluate(memory.state, command).next_state


def seen(state: Array) -> Array:
    """What a robot measures of its state."""
    return state


@dataclass(frozen=True)
class Toy:
    """A robot and its nominal map.

    Attributes:
        nominal: The nominal map.
        real: The map by which the robot really steps, if its law uses one.
        law: How it steps.
        measured: What it measures of its state.
        noise: Deviation of the noise of each measured state [half ranges].
        start: Its first true state; the middle of the ranges if None.
    """

    nominal: StepMap = field(default_factory=ToyMap)
    real: StepMap = field(default_factory=lambda: ToyMap(keep=0.65, push=0.022, lift=0.0027))
    law: Law = as_mapped
    measured: Callable[[Array], Array] = seen
    noise: float = 0.01
    start: tuple[float, ...] | None = None


class ToyPlant(RepeatablePlant):
    """Executes the steps of a toy."""

    def __init__(self, toy: Toy, rng: np.random.Generator):
        self._toy, self._rng = toy, rng
        self._memory = Memory(np.array([]))
        self._measured = np.array([])

    @property
    def space(self) -> StepSpace:
        return self._toy.nominal.space

    def start(self) -> Array:
        start = self.space.state_centre if self._toy.start is None else np.array(self._toy.start)
        self._memory = Memory(start)
        self._measured = self._toy.measured(start)
        return self._measured

    def take_step(self, command: Array) -> StepRecord:
        before, applied = self._measured, self._applied(command)
        self._measured = self._step(self._memory, applied, self._rng)
        failed = (
            not np.isfinite(self._measured).all() or (np.abs(self.space.scaled_state(self._memory.state)) > 60).any()
        )
        if failed:
            self._measured = np.full_like(self._measured, np.nan)
        status = StepStatus.FELL if failed else StepStatus.OK
        return StepRecord(before, command, applied, self._measured, status, requested=applied)

    def repeated(self, command: Array, rng: np.random.Generator, turned: float = 0.0) -> Array:  # noqa: ARG002
        return self._step(deepcopy(self._memory), self._applied(command), rng)

    def stop(self) -> None:
        pass

    def _applied(self, command: Array) -> Array:
        return np.clip(command, self.space.command_lower, self.space.command_upper)

    def _step(self, memory: Memory, command: Array, rng: np.random.Generator) -> Array:
        memory.commands.append(command)
        memory.state = self._toy.law(self._toy.real, memory, command, rng)
        noise = self._toy.noise * self.space.state_scale * rng.normal(size=len(memory.state))
        return self._toy.measured(memory.state + noise)


@dataclass(frozen=True)
class ToySimulation(Simulation):
    """The simulation of a toy."""

    toy: Toy

    def plant(self, rng: np.random.Generator, on_ticks: OnTicks | None = None) -> ToyPlant:  # noqa: ARG002
        return ToyPlant(self.toy, rng)

    def repeatable_plant(self, rng: np.random.Generator) -> ToyPlant:
        return ToyPlant(self.toy, rng)


@dataclass(frozen=True)
class ToyRobot(Robot):
    """A toy as a robot."""

    name = "toy"
    toy: ClassVar[Toy]

    @property
    def space(self) -> StepSpace:
        return self.toy.nominal.space

    def nominal_maps(self) -> Mapping[str, Callable[[], StepMap]]:
        return {"equations": lambda: self.toy.nominal}

    def simulations(self) -> Mapping[str, Callable[[np.random.Generator], Simulation]]:
        return {"equations": lambda world: ToySimulation(self.toy)}


def experiment_of(toy: Toy, seed: int = 0) -> Experiment:
    """Settings of an experiment with a toy."""
    kind: Any = type("Toy", (ToyRobot,), {"toy": toy})
    return Experiment(kind(), seed=seed)


# Laws with a fault, or with something that a healthy robot may have.


def commanded(change: Callable[[Array], Array]) -> Law:
    """The robot takes other commands than it is given."""
    return lambda step_map, memory, command, rng: as_mapped(step_map, memory, change(command), rng)


def late(steps: int) -> Law:
    """Commands act some steps later; the first ones are zero."""

    def law(step_map: StepMap, memory: Memory, command: Array, rng: np.random.Generator) -> Array:
        earlier = memory.commands[-1 - steps] if len(memory.commands) > steps else np.zeros_like(command)
        return as_mapped(step_map, memory, earlier, rng)

    return law


def first_late(step_map: StepMap, memory: Memory, command: Array, rng: np.random.Generator) -> Array:
    """The first command acts one step late."""
    before = memory.commands[-2] if len(memory.commands) > 1 else command
    return as_mapped(step_map, memory, np.array([before[0], command[1]]), rng)


def added(more: Callable[[Memory, Array, np.random.Generator], ArrayLike]) -> Law:
    """Something is added to each next state."""
    return lambda step_map, memory, command, rng: (
        as_mapped(step_map, memory, command, rng) + np.asarray(more(memory, command, rng))
    )


def spring(memory: Memory, command: Array, rng: np.random.Generator) -> Array:
    """A spring that is not measured: it keeps what a force leaves in it."""
    memory.more["spring"] = 0.8 * memory.more.get("spring", 0.0) + 0.03 * command[0] + 0.01 * rng.normal()
    return np.array([0.0, 0.1 * memory.more["spring"]])


def legs(memory: Memory, command: Array, rng: np.random.Generator) -> Array:
    """Two legs that differ take turns."""
    return np.array([0.0, 0.05 * (-1) ** len(memory.commands)])


def dead_band(width: float) -> Callable[[Array], Array]:
    """Small commands do nothing."""
    return lambda command: np.sign(command) * np.maximum(np.abs(command) - width, 0)


def hysteresis(width: float) -> Law:
    """A play in the drives: a command moves them once it has passed the play."""

    def law(step_map: StepMap, memory: Memory, command: Array, rng: np.random.Generator) -> Array:
        held = memory.more.get("held", np.zeros_like(command))
        memory.more["held"] = np.clip(held, command - width, command + width)
        return as_mapped(step_map, memory, memory.more["held"], rng)

    return law


# Nominal maps with a fault.


@dataclass(frozen=True)
class WrongJacobian(ToyMap):
    """One derivative is multiplied by a factor."""

    entry: tuple[int, int] = (1, 3)
    factor: float = -1.0

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        matrix = difference_jacobian(self, state, command)
        matrix[..., self.entry[0], self.entry[1]] *= self.factor
        return matrix


@dataclass(frozen=True)
class Jumping(ToyMap):
    """The height jumps where the speed passes one value."""

    jump: float = 0.02

    def formula(self, state: Array, command: Array) -> Array:
        return super().formula(state, command) + np.stack(
            np.broadcast_arrays(0 * command[..., 0] * state[..., 0], self.jump * (state[..., 0] > 0.47)), axis=-1
        )


@dataclass(frozen=True)
class Restless(ToyMap):
    """A map with noise."""

    def formula(self, state: Array, command: Array) -> Array:
        ends = super().formula(state, command)
        return ends + 1e-3 * np.random.default_rng().normal(size=ends.shape)


@dataclass(frozen=True)
class Remembering(ToyMap):
    """A map that goes on where it stopped."""

    last: list[float] = field(default_factory=lambda: [0.0])

    def formula(self, state: Array, command: Array) -> Array:
        ends = super().formula(state, command) + 0.01 * self.last[0]
        self.last[0] = float(np.mean(command))
        return ends


@dataclass(frozen=True)
class Careless(ToyMap):
    """A map that changes its argument."""

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        given = np.asarray(state, float)
        outcome = super().evaluate(given, command)
        if given.flags.writeable:
            given -= self.space.state_centre
        return outcome


@dataclass(frozen=True)
class Infinite(ToyMap):
    """A map whose height is no number for large forces, although its status is OK."""

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        ends, status = super().evaluate(state, command)
        height = np.where(np.asarray(command)[..., 1] > 8, np.nan, ends[..., 1])
        return Outcome(np.stack([ends[..., 0], height], axis=-1), status)


@dataclass(frozen=True)
class Batched(ToyMap):
    """A map that uses the first state of many for all."""

    def formula(self, state: Array, command: Array) -> Array:
        first = state.reshape(-1, state.shape[-1])[0] if state.ndim > 1 else state
        return super().formula(0 * state + first, command)


@dataclass(frozen=True)
class Falling(ToyMap):
    """A map that falls in the middle."""

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        ends, _ = super().evaluate(state, command)
        return Outcome(np.full_like(ends, np.nan), np.full(ends.shape[:-1], int(StepStatus.FELL)))


@dataclass(frozen=True)
class WithIdle(ToyMap):
    """A map with a third command that has no effect."""

    quantities: StepSpace = replace(HOPPER, command=(FX, FY, Quantity("stiffness", "N/m", 10.0, 30.0)))
