"""Small step maps with closed-form solutions; the tests of `control` share them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stepgap.step import (
    Array,
    Codes,
    ContextQuantity,
    Outcome,
    Quantity,
    StepMap,
    StepSpace,
    StepStatus,
    difference_jacobian,
)

SPEED, HEIGHT = Quantity("speed", "m/s", 0.0, 0.4), Quantity("height", "m", 0.52, 0.64)
YAW = ContextQuantity("yaw", "rad", period=2 * np.pi)
FX, FY = Quantity("fx", "N", -15.0, 15.0), Quantity("fy", "N", -20.0, 20.0)


class ClosedFormMap(StepMap):
    """A map given by a formula and by the region where it fails."""

    def next_state(self, state: Array, command: Array) -> Array:
        """The formula."""
        raise NotImplementedError

    def status(self, state: Array, command: Array) -> Codes:
        """Where it fails; nowhere unless a subclass defines it."""
        return np.full(np.broadcast_shapes(state.shape[:-1], command.shape[:-1]), StepStatus.OK)

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        state, command = np.asarray(state, float), np.asarray(command, float)
        status = np.asarray(self.status(state, command), np.int64)
        return Outcome(np.where((status == StepStatus.OK)[..., None], self.next_state(state, command), np.nan), status)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        return difference_jacobian(self, state, command)


@dataclass(frozen=True)
class LossyHopper(ClosedFormMap):
    """A point mass that hops: linear in speed, and in height an energy balance.

    m g y⁺ = m g (ground + (1 - loss) (y - ground)) + stroke (force + fy) + curve fy² - drag ẋ²
    """

    mass: float = 1.65
    gravity: float = 9.81
    ground: float = 0.28
    loss: float = 0.4
    stroke: float = 0.06
    force: float = 30.0
    curve: float = 0.001
    drag: float = 0.5
    keep: float = 0.7
    push: float = 0.02
    drift: float = 0.06

    @property
    def space(self) -> StepSpace:
        return StepSpace((SPEED, HEIGHT), (FX, FY), (YAW,))

    def next_state(self, state: Array, command: Array) -> Array:
        speed, height = state[..., 0], state[..., 1]
        fx, fy = command[..., 0], command[..., 1]
        energy = self.stroke * (self.force + fy) + self.curve * fy**2 - self.drag * speed**2
        next_height = self.ground + (1 - self.loss) * (height - self.ground) + energy / (self.mass * self.gravity)
        return np.stack([self.keep * speed + self.push * fx + self.drift, next_height], axis=-1)

    def command_for(self, state: Array, target: Array) -> Array:
        """Closed-form inverse; NaN where no force is enough."""
        fx = (target[0] - self.drift - self.keep * state[0]) / self.push
        lift = target[1] - self.ground - (1 - self.loss) * (state[1] - self.ground)
        wanted = lift * self.mass * self.gravity + self.drag * state[0] ** 2 - self.stroke * self.force
        root = self.stroke**2 + 4 * self.curve * wanted
        fy = (np.sqrt(root) - self.stroke) / (2 * self.curve) if root >= 0 else np.nan
        return np.array([fx, fy])


@dataclass(frozen=True)
class PitchingHopper(LossyHopper):
    """The same with a pitch and its rate, which are predicted but not tracked: more states than commands.

    The pitch obeys damped linear dynamics that speed and fx excite, and it changes the speed.
    """

    lean: float = 0.15

    @property
    def space(self) -> StepSpace:
        pitch = Quantity("pitch", "rad", -0.4, 0.4, weight=0), Quantity("pitch_rate", "rad/s", -2.0, 2.0, weight=0)
        return StepSpace((SPEED, HEIGHT, *pitch), (FX, FY))

    def next_state(self, state: Array, command: Array) -> Array:
        pitch, rate = state[..., 2], state[..., 3]
        hop = super().next_state(state[..., :2], command) + np.stack([self.lean * pitch, 0 * pitch], axis=-1)
        next_pitch = 0.5 * pitch + 0.08 * rate + 0.2 * state[..., 0]
        next_rate = -0.6 * pitch + 0.3 * rate + 0.02 * command[..., 0]
        return np.concatenate([hop, np.stack(np.broadcast_arrays(next_pitch, next_rate), axis=-1)], axis=-1)


@dataclass(frozen=True)
class StumblingHopper(LossyHopper):
    """The same, coupled and nonlinear; it falls beyond an oblique line and does not take off below a force."""

    fall_line: float = 0.8
    least_force: float = -12.0

    def next_state(self, state: Array, command: Array) -> Array:
        plain = super().next_state(state, command)
        fx, fy = command[..., 0] / 15, command[..., 1] / 20
        return plain + np.stack([0.03 * np.sin(2 * fy) + 0.02 * fx * fy, -0.006 * fx**2 + 0.004 * fx], axis=-1)

    def status(self, state: Array, command: Array) -> Codes:
        falls = command[..., 0] / 15 + command[..., 1] / 20 > self.fall_line
        low = command[..., 1] < self.least_force
        status = np.where(falls, StepStatus.FELL, np.where(low, StepStatus.NO_TAKE_OFF, StepStatus.OK))
        return np.broadcast_to(status, np.broadcast_shapes(state.shape[:-1], command.shape[:-1]))


class Track(ClosedFormMap):
    """Lateral offset and its rate, which one push changes: a double integrator."""

    @property
    def space(self) -> StepSpace:
        state = Quantity("offset", "m", -0.5, 0.5), Quantity("rate", "m/s", -1.0, 1.0)
        return StepSpace(state, (Quantity("push", "N", -1.0, 1.0),))

    def next_state(self, state: Array, command: Array) -> Array:
        rate = state[..., 1] + 0.4 * command[..., 0]
        return np.stack(
            np.broadcast_arrays(state[..., 0] + 0.3 * state[..., 1] + 0.06 * command[..., 0], rate), axis=-1
        )


class RedundantMap(ClosedFormMap):
    """Three commands for two coordinates."""

    @property
    def space(self) -> StepSpace:
        return StepSpace((SPEED, HEIGHT), (FX, FY, Quantity("angle", "rad", -0.2, 0.3)))

    def next_state(self, state: Array, command: Array) -> Array:
        fx, fy, angle = command[..., 0], command[..., 1], command[..., 2]
        speed = 0.6 * state[..., 0] + 0.01 * fx - 0.4 * np.sin(angle) + 0.08
        height = 0.6 * state[..., 1] + 0.004 * fy * np.cos(angle) + 0.22
        return np.stack([speed, height], axis=-1)


class ScalarMap(ClosedFormMap):
    """One command for two coordinates: both grow with it, so a target is reached only on a curve."""

    @property
    def space(self) -> StepSpace:
        return StepSpace((SPEED, HEIGHT), (FY,))

    def next_state(self, state: Array, command: Array) -> Array:
        force = command[..., 0] / 20
        speed, height = 0.5 * state[..., 0] + 0.1, 0.5 * state[..., 1] + 0.29
        return np.stack([speed + 0.1 * force, height + 0.03 * force**3], axis=-1)


class FoldedMap(ClosedFormMap):
    """One command, one coordinate, three minima of different depth: a descent from the middle ends in a wrong one."""

    @property
    def space(self) -> StepSpace:
        return StepSpace((Quantity("height", "m", 0.0, 2.0),), (Quantity("force", "N", -1.0, 1.0),))

    def next_state(self, state: Array, command: Array) -> Array:
        return 1.5 - 0.5 * command - 0.5 * np.cos(6 * command) + 0 * state


class NeverWorks(LossyHopper):
    """Falls with every command."""

    def status(self, state: Array, command: Array) -> Codes:
        return np.full(np.broadcast_shapes(state.shape[:-1], command.shape[:-1]), StepStatus.FELL)


@dataclass(frozen=True)
class RoughMap(LossyHopper):
    """A map with jumps of the size that an adaptive integrator leaves."""

    grain: float = 1e-8

    def next_state(self, state: Array, command: Array) -> Array:
        return np.round(super().next_state(state, command) / self.grain) * self.grain


@dataclass
class CountingMap(StepMap):
    """Counts the evaluations of another map; a Jacobian costs as much as central differences."""

    inner: StepMap
    evaluations: int = 0
    jacobians: int = 0

    @property
    def space(self) -> StepSpace:
        return self.inner.space

    @property
    def cost(self) -> int:
        """Cost in evaluations."""
        return self.evaluations + 2 * (len(self.space.state) + len(self.space.command)) * self.jacobians

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        outcome = self.inner.evaluate(state, command)
        self.evaluations += outcome.status.size
        return outcome

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        self.jacobians += 1
        return self.inner.jacobian(state, command)

    @property
    def noise_std(self) -> Array:
        return self.inner.noise_std

    def std(self, state: ArrayLike, command: ArrayLike) -> Array:
        return self.inner.std(state, command)

    def std_gradient(self, state: ArrayLike, command: ArrayLike) -> Array:
        return self.inner.std_gradient(state, command)


class WavyMap(ClosedFormMap):
    """A map of n state coordinates and m commands with several solutions of most targets."""

    def __init__(self, n: int, m: int):
        rng = np.random.default_rng(100 * n + m)
        self._by_state, self._by_command = rng.standard_normal((n, n)) / 2 / n, rng.standard_normal((n, m)) / np.sqrt(m)
        state = tuple(Quantity(f"s{i}", "m", -1.0, 1.0) for i in range(n))
        self._space = StepSpace(state, tuple(Quantity(f"c{i}", "N", -2.0, 2.0) for i in range(m)))

    @property
    def space(self) -> StepSpace:
        return self._space

    def next_state(self, state: Array, command: Array) -> Array:
        return state @ self._by_state.T + (command + 0.3 * np.sin(3 * command)) @ self._by_command.T
