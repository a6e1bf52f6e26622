"""A hopping robot in 3-D whose state at the apex has 12 or 30 numbers, of which three are tracked.

The motion follows from the velocity, height, attitude and rates of the body (with a yaw rate for 30 numbers), and from
how far each leg joint is from where the leg controller wants it at the apex, which shifts the foot at the next
touchdown. Joint angles and rates are nearly functions of the rest: the leg controller prepares the touchdown by
velocity, attitude and command, and the joints follow it but for a deviation that decays from step to step. The angle of
a tail and the temperature of a motor drive nothing.

The real robot differs from the nominal map: its feet slip, a deviation of a joint and the attitude bend the leg, thrust
acts along the tilted body, drag and losses are larger, and the joints sag under gravity. The numbers of `Physics` and
the fixed geometry of the legs are the same for all seeds; what a seed changes is noise, reference and the size of each
difference.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.plants.model_plant import ModelPlant
from stepgap.plants.plant import Plant
from stepgap.step import Array, Outcome, Quantity, StepMap, StepRecord, StepSpace, StepStatus, difference_jacobian

OUTPUTS = (
    Quantity("vx", "m/s", -0.2, 1.0),
    Quantity("vy", "m/s", -0.4, 0.4),
    Quantity("height", "m", 0.5, 0.7),
)
"""The tracked numbers."""

COMMAND = (
    Quantity("foot_x", "m", -0.15, 0.15),
    Quantity("foot_y", "m", -0.10, 0.10),
    Quantity("thrust", "N", -30.0, 30.0),
    Quantity("hip", "N*m", -8.0, 8.0),
)

_BODY = (
    Quantity("roll", "rad", -0.2, 0.2, 0),
    Quantity("pitch", "rad", -0.2, 0.2, 0),
    Quantity("roll_rate", "rad/s", -1.0, 1.0, 0),
    Quantity("pitch_rate", "rad/s", -1.0, 1.0, 0),
)
_YAW_RATE = Quantity("yaw_rate", "rad/s", -1.5, 1.5, 0)
_TAIL = Quantity("tail", "rad", -0.6, 0.6, 0), Quantity("temperature", "degC", 20.0, 70.0, 0)

LARGEST_TILT = 0.7
"""Roll or pitch beyond which the robot falls [rad]."""

JOINT_SCALE, RATE_SCALE = 0.3, 3.0
"""Half ranges of joint angles [rad] and rates [rad/s]."""


@final
@dataclass(frozen=True)
class Physics:
    """Numbers in which the real robot differs from the nominal map; the defaults are nominal.

    Attributes:
        slip: Part of the horizontal velocity that is lost in stance, where the foot slips [1 per m/s].
        bend: Shift of the foot per deviation of the joints, and per tilt of the body under thrust [m/rad].
        tilt: Horizontal velocity per sine of the tilt, from thrust along the body [m/s].
        drag: Height lost per squared velocity [m per (m/s)²].
        loss: Part of the height above the rest length that is lost per step.
        torque: Rate per torque of the hip and per offset of the foot, in nominal units.
        sag: Joint angle by which gravity bends the joints [rad].
        follow: Part of the deviation of a joint that is left after a step.
        geometry: Relative error of the nominal relation of joints and body.
    """

    slip: float = 0.0
    bend: float = 0.1
    tilt: float = 0.6
    drag: float = 0.02
    loss: float = 0.35
    torque: float = 1.0
    sag: float = 0.0
    follow: float = 0.0
    geometry: float = 0.0

    def real(self, rng: np.random.Generator) -> Self:
        """A real robot: each difference is drawn within ±30 % about its typical value."""
        some = dict(zip(self.__dataclass_fields__, rng.uniform(0.7, 1.3, 9), strict=True))
        return replace(
            self,
            slip=0.5 * some["slip"],
            bend=0.3 * some["bend"],
            tilt=1.0 * some["tilt"],
            drag=0.07 * some["drag"],
            loss=0.45 * some["loss"],
            torque=0.75 * some["torque"],
            sag=0.06 * some["sag"],
            follow=0.5 * some["follow"],
            geometry=0.2 * some["geometry"],
        )


@final
@dataclass(frozen=True)
class ApexMap(StepMap):
    """The step map of the robot.

    Attributes:
        size: 12 or 30 numbers of the state; 3: those of the outputs only, with the others at rest.
        physics: Its numbers.
    """

    size: int
    physics: Physics = Physics()

    @property
    def space(self) -> StepSpace:
        """Three tracked outputs, then the numbers that are only predicted, and four commands."""
        return self._space

    @cached_property
    def _space(self) -> StepSpace:
        if self.size == len(OUTPUTS):
            return StepSpace(OUTPUTS, COMMAND)
        angles, rates = (12, 8) if self.size == 30 else (3, 0)
        joints = [Quantity(f"joint_{k}", "rad", -JOINT_SCALE, JOINT_SCALE, 0) for k in range(angles)]
        joints += [Quantity(f"joint_rate_{k}", "rad/s", -RATE_SCALE, RATE_SCALE, 0) for k in range(rates)]
        body = (*_BODY, _YAW_RATE) if self.size == 30 else _BODY
        return StepSpace((*OUTPUTS, *body, *joints, *_TAIL), COMMAND)

    @cached_property
    def _legs(self) -> tuple[Array, Array, Array]:
        """How joints depend on body (k, b) and command (k, 4), all in half ranges; how they shift the foot (2, k)."""
        rng = np.random.default_rng(self.size)
        body = 8 if self.size == 30 else 7
        joints = self.size - body - len(_TAIL)
        by_body = rng.normal(0, 0.5 / np.sqrt(body), (joints, body))
        by_command = rng.normal(0, 0.2 / np.sqrt(len(COMMAND)), (joints, len(COMMAND)))
        return by_body, by_command, rng.normal(0, 1 / np.sqrt(joints), (2, joints))

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes."""
        state, command = np.asarray(state, float), np.asarray(command, float)
        leading = np.broadcast_shapes(state.shape[:-1], command.shape[:-1])
        full = np.broadcast_to(state, (*leading, state.shape[-1]))
        command = np.broadcast_to(command, (*leading, len(COMMAND)))
        if self.size == len(OUTPUTS):
            whole = replace(self, size=12)
            rest = np.broadcast_to(whole.space.state_centre[3:], (*leading, 9))
            next_state, status = whole.evaluate(np.concatenate([full, rest], axis=-1), command)
            return Outcome(next_state[..., :3], status)
        next_state = self._next(full, command)
        fell = (np.abs(next_state[..., 3:5]) > LARGEST_TILT).any(axis=-1) | (next_state[..., 2] < 0.4)
        fell |= ~np.isfinite(next_state).all(axis=-1)
        status = np.where(fell, StepStatus.FELL, StepStatus.OK).astype(np.int64)
        return Outcome(np.where(fell[..., None], np.nan, next_state), status)

    def _next(self, state: Array, command: Array) -> Array:
        """Next states of the whole robot; shape (…, n)."""
        real, space = self.physics, self.space
        by_body, _, shift = self._legs
        joints, size = len(by_body), by_body.shape[1]
        vx, vy, height, roll, pitch, roll_rate, pitch_rate = np.moveaxis(state[..., :7], -1, 0)
        foot_x, foot_y, thrust, hip = np.moveaxis(command / space.command_scale, -1, 0)
        deviation = self._scaled(state)[..., size : size + joints] - self._posture(
            self._scaled(state)[..., :size], 0 * command
        )
        bent = JOINT_SCALE * real.bend * np.tanh(deviation) @ shift.T
        push = 1 + 0.3 * thrust
        at_x = 0.15 * foot_x + bent[..., 0] + real.bend * pitch * push
        at_y = 0.10 * foot_y + bent[..., 1] - real.bend * roll * push
        speed = np.sqrt(0.01 + vx**2 + vy**2)
        next_vx = 0.75 * vx + 0.1 - 3.0 * at_x * push + real.tilt * np.sin(pitch) * push - real.slip * speed * vx
        next_vy = 0.70 * vy - 3.0 * at_y * push - real.tilt * np.sin(roll) * push - real.slip * speed * vy
        fall = real.loss * (height - 0.6) + real.drag * (vx**2 + vy**2) + 0.3 * (roll**2 + pitch**2)
        next_height = height - fall + 0.1 * thrust * np.cos(roll) * np.cos(pitch)
        next_roll = 0.4 * roll + 0.12 * roll_rate + 0.2 * vy + 1.5 * at_y * real.torque
        next_pitch = 0.4 * pitch + 0.12 * pitch_rate - 0.15 * (vx - 0.4) + real.torque * (0.06 * hip + 1.2 * at_x)
        next_roll_rate = 0.5 * roll_rate - 2.5 * np.sin(roll) * push + 6.0 * at_y * real.torque
        next_pitch_rate = 0.5 * pitch_rate - 2.5 * np.sin(pitch) * push + real.torque * (0.4 * hip + 5.0 * at_x)
        body = [next_vx, next_vy, next_height, next_roll, next_pitch, next_roll_rate, next_pitch_rate]
        if size == 8:
            body.append(0.5 * state[..., 7] + 0.4 * foot_x * foot_y + 0.5 * vy * roll)
        moved = (np.stack(body, axis=-1) - space.state_centre[:size]) / space.state_scale[:size]
        posture = self._posture(moved, command / space.command_scale) + real.follow * deviation
        tail, temperature = state[..., -2], state[..., -1]
        others = [0.8 * tail, temperature + 0.03 * (40 + 10 * thrust**2 - temperature)]
        scaled = np.concatenate([moved, posture], axis=-1)
        whole = space.state_centre[:-2] + space.state_scale[:-2] * scaled
        return np.concatenate([whole, np.stack(others, axis=-1)], axis=-1)

    def _posture(self, body: Array, command: Array) -> Array:
        """Joints that the leg controller wants for a body and a command, all in half ranges; shape (…, k)."""
        by_body, by_command, _ = self._legs
        real, rng = self.physics, np.random.default_rng(self.size + 1)
        wrong = 1 + real.geometry * rng.normal(size=by_body.shape)
        loads = rng.uniform(-1, 1, len(by_body))
        sag = real.sag / JOINT_SCALE * loads * np.cos(body[..., 3:4]) * np.cos(body[..., 4:5] + loads)
        return body @ (by_body * wrong).T + command @ by_command.T + sag

    def _scaled(self, state: Array) -> Array:
        return (state - self.space.state_centre) / self.space.state_scale

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command) by central differences."""
        return difference_jacobian(self, state, command)

    @property
    def noise(self) -> Array:
        """Standard deviation of the noise of each number after a step [units of the state]; shape (n,)."""
        return 0.01 * self.space.state_scale


class OutputsPlant(Plant):
    """A plant of which only the three outputs are measured."""

    def __init__(self, inner: ModelPlant):
        self._inner = inner

    @property
    def space(self) -> StepSpace:
        """The outputs and the commands."""
        return StepSpace(OUTPUTS, COMMAND)

    def start(self) -> Array:
        """Starts the whole robot and returns its outputs."""
        return self._inner.start()[:3]

    def take_step(self, command: Array) -> StepRecord:
        """A step of the whole robot, of which the outputs are recorded."""
        record = self._inner.take_step(command)
        ends = {name: getattr(record, name)[:3] for name in ("state", "next_state", "true_next_state")}
        return replace(record, **ends)

    def stop(self) -> None:
        """Stops the robot."""
        self._inner.stop()
