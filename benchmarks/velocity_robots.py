"""Robots that are commanded velocities, for `benchmarks/trust.py`: two of equations, and a public policy of a Go1.

A step lasts 0.5 s; its state is the mean velocity of it, the nominal map is "next velocity = command".

- `Walker`: forward speed and yaw rate. It stands or trots, with hysteresis between 0.1 and 0.2 m/s, and brakes and
  accelerates by a limited amount a step. A command far from the present speed stresses its gait; stressed too much, the
  gait breaks: the walker then rushes with 0.5 to 1.0 m/s whatever it is told, and falls if the stress goes on. The
  command of the uncorrected controller, which is the target, never stresses it so much, however the target changes. So
  were the failures of a humanoid whose command was at its bound for several steps.
- `Stroller`: velocity forward, to the left, and of turning. It has dead bands, offsets, cross-coupling and lag, as
  measured of a Go1 policy on a slope with a payload, and does not fall.
- `Go1`: the policy itself in MuJoCo, `go1.onnx` with its models in a folder, 50 Hz (needs `onnxruntime`).
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from abc import ABC, abstractmethod
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from stepgap.plants.plant import Plant
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.step import Array, Quantity, StepRecord, StepSpace, StepStatus

FORWARD, LEFT, TURN = (
    Quantity("vx", "m/s", 0.0, 1.0),
    Quantity("vy", "m/s", -0.3, 0.3),
    Quantity("wz", "rad/s", -0.6, 0.6),
)
COMMANDS = (
    Quantity("cx", "m/s", -0.2, 1.4),
    Quantity("cy", "m/s", -0.5, 0.5),
    Quantity("cw", "rad/s", -1.2, 1.2),
)
WALKER_SPACE = StepSpace((FORWARD, TURN), (COMMANDS[0], COMMANDS[2]))
STROLLER_SPACE = StepSpace((FORWARD, LEFT, TURN), COMMANDS)

START = 0.5
"""Forward velocity at the start [m/s]."""

STRAIN, STRAIN_LIMIT = 0.45, 2.4
"""Distance of command and speed from which the gait is stressed [m/s]; stress at which the walker falls.

A walker at 0.8 m/s whose command then stays at its lower bound falls within nine steps in a fifth of the cases, never
within three; at 0.95 m/s in two thirds. With command = target, none of 200 walkers fell on its reference.
"""


class VelocityBody(ABC):
    """A robot that is commanded velocities."""

    @abstractmethod
    def step(self, command: Array, rng: np.random.Generator) -> Array | None:
        """Mean velocity of the next step; None if the robot fell."""

    @abstractmethod
    def push(self, speed: float) -> None:
        """Changes the forward velocity at once [m/s]."""

    @abstractmethod
    def change(self) -> None:
        """Changes the robot, as when a load is picked up."""


class Walker(VelocityBody):
    """Stand and trot, and a gait that breaks.

    Args:
        robot: Draws what differs between walkers.
    """

    def __init__(self, robot: np.random.Generator):
        self._gain, self._offset = robot.uniform([0.8, 0.7], [1.05, 1.1]), robot.uniform(-0.06, 0.06, 2)
        self._lag, self._brake, self._speed_up = robot.uniform(0.7, 0.95), robot.uniform(0.2, 0.35), 0.35
        self._velocity, self._trots, self._stress = np.array([START, 0.0]), True, 0.0

    def step(self, command: Array, rng: np.random.Generator) -> Array | None:
        """Mode, stress, and then the velocity with its limits."""
        speed = self._velocity[0]
        self._trots = command[0] > (0.1 if self._trots else 0.2) or speed > 0.3
        self._stress = 0.6 * self._stress + max(0.0, (abs(command[0] - speed) - STRAIN) / 0.55)
        if self._stress > STRAIN_LIMIT:
            return None
        if self._stress > 1.0:
            wanted = np.array([rng.uniform(0.5, 1.0), self._velocity[1] + rng.normal(0, 0.2)])
        elif self._trots:
            wanted = np.maximum(self._gain * command + self._offset, [0.1, -np.inf])
        else:
            wanted = np.zeros(2)
        change = self._lag * (wanted - self._velocity)
        change[0] = np.clip(change[0], -self._brake, self._speed_up)
        self._velocity = self._velocity + change + rng.normal(0, 0.01 if self._trots else 0.002, 2)
        return self._velocity

    def push(self, speed: float) -> None:
        """Changes the forward velocity."""
        self._velocity = self._velocity + np.array([speed, 0.0])

    def change(self) -> None:
        """A load: slower by a fifth, and turning to one side."""
        self._gain, self._offset = 0.8 * self._gain, self._offset + np.array([0.0, 0.08])


class Stroller(VelocityBody):
    """Dead bands, offsets, cross-coupling and lag.

    Args:
        robot: Draws what differs between strollers.
    """

    def __init__(self, robot: np.random.Generator):
        self._matrix = np.diag(robot.uniform(0.8, 1.05, 3)) + robot.uniform(-0.15, 0.15, (3, 3)) * (1 - np.eye(3))
        self._offset = robot.uniform(-1, 1, 3) * np.array([0.08, 0.08, 0.1])
        self._dead, self._lag = robot.uniform(0.03, 0.12, 3), robot.uniform(0.75, 0.95)
        self._velocity = np.array([START, 0.0, 0.0])

    def step(self, command: Array, rng: np.random.Generator) -> Array | None:  # noqa: ARG002
        """Velocity with lag towards that of the command outside its dead bands."""
        felt = np.where(np.abs(command) > self._dead, command, 0.0)
        wanted = self._matrix @ felt + (self._offset if felt.any() else 0.0)
        self._velocity = self._velocity + self._lag * (wanted - self._velocity)
        return self._velocity

    def push(self, speed: float) -> None:
        """Changes the forward velocity."""
        self._velocity = self._velocity + np.array([speed, 0.0, 0.0])

    def change(self) -> None:
        """A load at one side."""
        self._matrix, self._offset = 0.85 * self._matrix, self._offset + np.array([-0.03, 0.05, 0.06])


@cache
def _session(policy: str) -> Any:
    """The policy, which does not change."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return onnxruntime.InferenceSession(policy, options, providers=["CPUExecutionProvider"])


class Go1(VelocityBody):
    """A frozen policy of a quadruped, on a slope and with a payload.

    Args:
        folder: Folder with `go1.onnx` and `scene_mjx_feetonly_flat_terrain.xml`.
        robot: Draws slope, payload, strength and friction.
    """

    def __init__(self, folder: Path, robot: np.random.Generator):
        model = mujoco.MjSpec.from_file(str(folder / "scene_mjx_feetonly_flat_terrain.xml")).compile()
        model.opt.timestep, model.opt.iterations, model.opt.ls_iterations = 0.004, 10, 20
        slope = robot.uniform(-0.07, 0.07)
        model.opt.gravity[:] = [-9.81 * np.sin(slope), 0, -9.81 * np.cos(slope)]
        model.geom("floor").friction[0] = robot.uniform(0.5, 1.0)
        model.actuator_forcerange[:] *= robot.uniform(0.8, 1.0)
        self._model, self._trunk, self._policy = model, model.body("trunk").id, _session(str(folder / "go1.onnx"))
        self._load(robot.uniform(0.0, 3.0), robot.uniform(-0.05, 0.05, 3))
        self._data, self._home = mujoco.MjData(model), np.array(model.keyframe("home").qpos[7:])
        self._action, self._imu = np.zeros(12, np.float32), model.site("imu").id
        mujoco.mj_resetDataKeyframe(model, self._data, 0)
        mujoco.mj_forward(model, self._data)
        for _ in range(3):  # into its gait
            self.step(np.array([START, 0.0, 0.0]), robot)

    def _load(self, payload: float, place: Array) -> None:
        model, mass = self._model, self._model.body_mass[self._trunk]
        model.body_ipos[self._trunk] = (mass * model.body_ipos[self._trunk] + payload * place) / (mass + payload)
        model.body_mass[self._trunk] = mass + payload

    def step(self, command: Array, rng: np.random.Generator) -> Array | None:  # noqa: ARG002
        """Half a second of walking."""
        data, total = self._data, np.zeros(3)
        for _ in range(25):
            rotation = data.site_xmat[self._imu].reshape(3, 3)
            velocity, gyro = data.sensor("local_linvel").data, data.sensor("gyro").data
            posture = [velocity, gyro, -rotation[2], data.qpos[7:] - self._home, data.qvel[6:], self._action, command]
            (action,) = self._policy.run(["continuous_actions"], {"obs": np.hstack(posture)[None].astype(np.float32)})
            self._action = action[0]
            data.ctrl[:] = 0.5 * self._action + self._home
            for _ in range(5):
                mujoco.mj_step(self._model, data)
                total += [*data.sensor("local_linvel").data[:2], data.sensor("gyro").data[2]]
        up = data.site_xmat[self._imu].reshape(3, 3)[2, 2]
        return total / 125 if data.qpos[2] > 0.15 and up > 0.6 else None

    def push(self, speed: float) -> None:
        """Changes the velocity of the trunk along the world's x axis."""
        self._data.qvel[0] += speed

    def change(self) -> None:
        """A load of 2 kg at the front left."""
        self._load(2.0, np.array([0.1, 0.05, 0.05]))


def as_commanded(space: StepSpace) -> AffineMap:
    """The nominal map: the next velocity is the command."""
    n = len(space.state)
    return AffineMap(space, np.zeros(n), np.zeros(n), np.zeros(n), np.hstack([np.zeros((n, n)), np.eye(n)]))


class VelocityPlant(Plant):
    """A plant of such a robot.

    Args:
        space: Names, units and ranges.
        body: The robot.
        rng: Draws its noise.
        noise: Standard deviation of the noise of every measured velocity [m/s, rad/s].
    """

    def __init__(self, space: StepSpace, body: VelocityBody, rng: np.random.Generator, noise: float = 0.01):
        self._space, self._body, self._rng, self._noise = space, body, rng, noise
        self._state = np.full(len(space.state), np.nan)

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self._space

    def start(self) -> Array:
        """A first step forward, whose end is the first state."""
        first = self._body.step(np.eye(len(self._state))[0] * START, self._rng)
        self._state = self._measured(self._state if first is None else first)
        return self._state

    def take_step(self, command: Array) -> StepRecord:
        """A step with the command, limited to its bounds."""
        applied = np.clip(command, self._space.command_lower, self._space.command_upper)
        true, before = self._body.step(applied, self._rng), self._state
        status = StepStatus.FELL if true is None else StepStatus.OK
        self._state = self._measured(np.full(len(before), np.nan) if true is None else true)
        return StepRecord(before, command, applied, self._state, status, requested=applied)

    def stop(self) -> None:
        """Does nothing: a simulation stands still."""

    def _measured(self, velocity: Array) -> Array:
        return velocity + self._rng.normal(0, self._noise, len(velocity))
