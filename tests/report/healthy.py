"""Random healthy robots for the tests of `stepgap check`: other sizes, gaps, noise, dead bands, play, saturation."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stepgap.step import Array, Outcome, Quantity, StepMap, StepSpace, StepStatus, difference_jacobian
from tests.report.toy_robots import Law, Memory, Toy, as_mapped


@dataclass(frozen=True, eq=False)
class RandomMap(StepMap):
    """A stable map of random couplings that bends.

    Attributes:
        quantities: Its ranges.
        by_state: Derivatives by the state [half ranges]; shape (n, n).
        by_command: Those by the command; shape (n, m).
        bend: Weights of squares of state and command; shape (n, n + m).
        offset: Constant part; shape (n,).
    """

    quantities: StepSpace
    by_state: Array
    by_command: Array
    bend: Array
    offset: Array

    @property
    def space(self) -> StepSpace:
        return self.quantities

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        x = self.space.scaled_state(np.asarray(state, float))
        u = self.space.point_of(np.asarray(command, float))
        x, u = np.broadcast_arrays(x, np.zeros((*u.shape[:-1], x.shape[-1])))[0], u
        u = np.broadcast_to(u, (*x.shape[:-1], u.shape[-1]))
        squares = np.tanh(np.concatenate([x, u], axis=-1) ** 2)
        ends = x @ self.by_state.T + u @ self.by_command.T + squares @ self.bend.T + self.offset
        status = np.where(np.isfinite(ends).all(axis=-1), StepStatus.OK, StepStatus.INVALID)
        return Outcome(self.space.state_centre + self.space.state_scale * ends, status.astype(np.int64))

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        return difference_jacobian(self, state, command)


def random_healthy(seed: int) -> Toy:
    """A random robot that differs from its map as a good one does."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    m = int(rng.integers(max(1, n - 1), n + 1))
    space = _space(rng, n, m)
    by_state = rng.normal(size=(n, n))
    by_state *= rng.uniform(0.2, 0.6) / np.linalg.norm(by_state, 2)
    by_command = 0.1 * rng.normal(size=(n, m))
    by_command[np.arange(m), np.arange(m)] = rng.choice([-1, 1], m) * rng.uniform(0.9, 1.6, m)
    bend = 0.1 * rng.normal(size=(n, n + m))
    nominal = RandomMap(space, by_state, by_command, bend, np.zeros(n))
    real = RandomMap(
        space,
        by_state * rng.uniform(0.8, 1.2, (n, n)),
        by_command * rng.uniform(0.7, 1.2, (n, m)),
        bend * rng.uniform(0, 2, (n, n + m)),
        0.15 * rng.uniform(-1, 1, n),
    )
    return Toy(nominal, real, law=_law(seed % 4, 0.1 * space.command_scale), noise=float(rng.uniform(0, 0.08)))


def _space(rng: np.random.Generator, n: int, m: int) -> StepSpace:
    """n states, of which the first m are tracked, and m commands."""
    state = []
    for row in range(n):
        middle, half = rng.normal(), rng.uniform(0.05, 2)
        weight = float(row < m)
        state.append(Quantity(f"x{row}", "m", middle - half, middle + half, weight))
    return StepSpace(tuple(state), tuple(Quantity(f"u{row}", "N", -5.0, 5.0 + row) for row in range(m)))


def _law(kind: int, width: Array) -> Law:
    """Drives that do as they are told, with a dead band, with a play, or that saturate."""

    def law(step_map: StepMap, memory: Memory, command: Array, rng: np.random.Generator) -> Array:
        if kind == 1:
            command = np.sign(command) * np.maximum(np.abs(command) - width, 0)
        if kind == 2:
            held = memory.more.get("held", np.zeros_like(command))
            command = memory.more["held"] = np.clip(held, command - width, command + width)
        if kind == 3:
            command = np.clip(command, -7 * width, 7 * width)
        return as_mapped(step_map, memory, command, rng)

    return law
