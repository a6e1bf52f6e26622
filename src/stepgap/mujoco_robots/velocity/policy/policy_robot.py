"""The robot `policy`: a MuJoCo model that a trained policy moves at a commanded velocity."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.ranges import require
from stepgap.mujoco_robots.velocity.policy.onnx_network import OnnxNetwork
from stepgap.mujoco_robots.velocity.policy.policy_model import actuators_of_joints, policy_spec, stand
from stepgap.mujoco_robots.velocity.policy.policy_settings import PolicySettings, read_policy_settings
from stepgap.mujoco_robots.velocity.walking_robot import WalkingControl, WalkingRobot
from stepgap.step import Array


class Moment(NamedTuple):
    """What terms of an observation are made of.

    Attributes:
        velocity: Velocity and angular velocity of the frame of the IMU, in this frame; shape (2, 3) [m/s, rad/s].
        gravity: Direction of gravity in the same frame; shape (3,).
        joint_pos: Positions of the joints less their default positions; shape (J,) [rad].
        joint_vel: Their velocities; shape (J,) [rad/s].
        actions: The actions before; shape (J,).
        command: Commanded velocities; shape (3,).
        clock: Sines and cosines of the gait's phases; shape (2, P).
    """

    velocity: Array
    gravity: Array
    joint_pos: Array
    joint_vel: Array
    actions: Array
    command: Array
    clock: Array


_VALUES: Final[Mapping[str, Callable[[Moment], Array]]] = {
    "base_lin_vel": lambda now: now.velocity[0],
    "base_ang_vel": lambda now: now.velocity[1],
    "projected_gravity": lambda now: now.gravity,
    "joint_pos": lambda now: now.joint_pos,
    "joint_vel": lambda now: now.joint_vel,
    "actions": lambda now: now.actions,
    "command": lambda now: now.command,
    "phase_sin": lambda now: now.clock[0],
    "phase_cos": lambda now: now.clock[1],
}


class Observation:
    """Observations with their history, from the start on.

    Args:
        settings: Terms, scales and history.
    """

    def __init__(self, settings: PolicySettings, model: Any):
        self._settings = settings
        joints = [model.joint(name).id for name in settings.joints]
        self._positions = model.jnt_qposadr[joints]
        self._rates = model.jnt_dofadr[joints]
        self._default = np.array(settings.default_joint_pos)
        self._scales = [np.array(getattr(settings.scale, term)) for term in settings.observation]
        kind = mujoco.mjtObj.mjOBJ_SITE if settings.imu else mujoco.mjtObj.mjOBJ_XBODY
        self._imu = int(kind), model.site(settings.imu).id if settings.imu else 1
        self._past = deque[list[Array]](maxlen=max(settings.histories))

    def next(self, model: Any, data: Any, actions: Array, command: Array, turns: float) -> Array:
        """The next observation; shape (sum of all sizes times their histories,).

        Args:
            actions: The actions before; shape (J,).
            command: Commanded velocities; shape (3,).
            turns: Periods of the gait's clock since the start.
        """
        now = self._moment(model, data, actions, command, turns)
        terms = zip(self._settings.observation, self._scales, strict=True)
        values = [scale * _VALUES[term](now) for term, scale in terms]
        self._past.extend([values] * (1 if self._past else self._past.maxlen or 1))
        if self._settings.history_by_term:
            lengths = enumerate(self._settings.histories)
            parts = [[past[number] for past in list(self._past)[-length:]] for number, length in lengths]
        else:
            parts = [[np.concatenate(past) for past in self._past]]
        order = -1 if self._settings.newest_first else 1
        return np.concatenate([numbers for part in parts for numbers in part[::order]])

    def _moment(self, model: Any, data: Any, actions: Array, command: Array, turns: float) -> Moment:
        kind, number = self._imu
        velocity = np.empty(6)  # angular first
        mujoco.mj_objectVelocity(model, data, kind, number, velocity, 1)
        rotation = (data.site_xmat if self._settings.imu else data.xmat)[number].reshape(3, 3)
        gravity = model.opt.gravity / np.linalg.norm(model.opt.gravity)
        return Moment(
            velocity=velocity.reshape(2, 3)[::-1],
            gravity=gravity @ rotation,
            joint_pos=data.qpos[self._positions] - self._default,
            joint_vel=data.qvel[self._rates],
            actions=actions,
            command=command,
            clock=self._clock(command, turns),
        )

    def _clock(self, command: Array, turns: float) -> Array:
        """Sines and cosines of the gait's phases; shape (2, P)."""
        offsets = np.array(self._settings.gait_offsets)
        shares = (turns + offsets) % 1.0
        if np.linalg.norm(command) < self._settings.gait_stands_below:
            if not self._settings.gait_standing:
                return np.zeros((2, len(offsets)))
            shares = np.array(self._settings.gait_standing)
        phase = 2 * np.pi * shares
        return np.array([np.sin(phase), np.cos(phase)])


class PolicyControl(WalkingControl):
    """A policy with the memory that its observation has."""

    def __init__(self, settings: PolicySettings, network: OnnxNetwork):
        self._settings = settings
        self._network = network
        self.period = settings.period

    def start(self, model: Any, data: Any) -> None:
        """Forgets all observations and actions; actuators of other joints keep their control signals."""
        self._observation = Observation(self._settings, model)
        self._actions = np.zeros(len(self._settings.joints))
        self._calls = 0
        self._quickened = 0.0
        self._ctrl = data.ctrl.copy()
        actuators = actuators_of_joints(model)
        self._actuators = [actuators[joint] for joint in self._settings.joints]

    def control(self, model: Any, data: Any, command: Array) -> Array:
        """Observes, and computes the targets of the joints."""
        settings = self._settings
        turns = self._calls * self.period / settings.gait_period + self._quickened
        observation = self._observation.next(model, data, self._actions, command, turns)
        quick = settings.gait_quickening * min(float(np.linalg.norm(command)), settings.gait_quickens_to)
        self._quickened += quick * self.period
        clip = settings.action_clip
        scale = np.array(settings.action_scale)
        self._actions = np.clip(self._network(observation), -clip, clip)
        self._calls += 1
        self._ctrl[self._actuators] = np.array(settings.default_joint_pos) + scale * self._actions
        return self._ctrl


@dataclass(frozen=True)
class PolicyFile:
    """Where the policy is.

    Attributes:
        file: A `policy.toml`, as `stepgap new --policy` writes it; the path is relative to the experiment's file.
    """

    file: str = ""


@dataclass(frozen=True)
class PolicyRobot(WalkingRobot):
    """A robot that a trained policy moves.

    Attributes:
        policy: Where the policy is.
    """

    policy: PolicyFile = field(default_factory=PolicyFile)

    name = "policy"
    files = {"policy.file": False}  # noqa: RUF012

    def check(self) -> None:
        """Raises ValueError if no policy is named."""
        wanted = "name a policy.toml, as stepgap new FOLDER --policy POLICY.onnx --mjcf MODEL.xml writes"
        require(bool(self.policy.file), "policy.file", self.policy.file, wanted)

    @property
    def tick(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Time step of the simulation [s]."""
        return self._settings.timestep

    @cached_property
    def _settings(self) -> PolicySettings:
        return read_policy_settings(Path(self.policy.file))

    @cached_property
    def _network(self) -> OnnxNetwork:
        file = Path(self.policy.file)
        network = OnnxNetwork(file.parent / self._settings.policy)
        check_network(self._settings, network.input_size, network.output_size, file)
        return network

    def mjcf_spec(self) -> Any:
        """The model of the policy."""
        return policy_spec(self._settings, Path(self.policy.file))

    def stand(self, model: Any, data: Any) -> None:
        """On the ground, in the default posture of the policy."""
        stand(self._settings.joints, self._settings.default_joint_pos, model, data)

    def walking_control(self) -> PolicyControl:
        """The policy without memory of the past."""
        return PolicyControl(self._settings, self._network)


def check_network(settings: PolicySettings, inputs: int, outputs: int, file: Path) -> None:
    """Ensures that observation and actions have the sizes of the network.

    Args:
        inputs: Size of the input of its network.
        outputs: Size of its output.
        file: Its `policy.toml`, for messages.

    Raises:
        InputError: They have others.
    """
    sizes = [settings.sizes[term] for term in settings.observation]
    total = sum(size * length for size, length in zip(sizes, settings.histories, strict=True))
    if total != inputs:
        terms = ", ".join(f"{term} {size}" for term, size in zip(settings.observation, sizes, strict=True))
        times = f", history {', '.join(map(str, settings.history))}" if settings.history != (1,) else ""
        text = f"its terms have {total} numbers ({terms}{times}), but {settings.policy} wants {inputs}"
        raise InputError(f"{file}: observation: {text}; give the terms of the training")
    if len(settings.joints) != outputs:
        number = len(settings.joints)
        raise InputError(
            f"{file}: joints: there are {number}, but {settings.policy} has {outputs} actions; give a joint for each"
        )
