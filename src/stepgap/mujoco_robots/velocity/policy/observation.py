"""The observation of a policy: what its network is given, computed from a MuJoCo model."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np

from stepgap.mujoco_robots.velocity.policy.policy_settings import PolicySettings
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
        phase: Phases of the gait; shape (P,) [rad].
    """

    velocity: Array
    gravity: Array
    joint_pos: Array
    joint_vel: Array
    actions: Array
    command: Array
    phase: Array


_VALUES: Final[Mapping[str, Callable[[Moment], Array]]] = {
    "base_lin_vel": lambda now: now.velocity[0],
    "base_ang_vel": lambda now: now.velocity[1],
    "projected_gravity": lambda now: now.gravity,
    "joint_pos": lambda now: now.joint_pos,
    "joint_vel": lambda now: now.joint_vel,
    "actions": lambda now: now.actions,
    "command": lambda now: now.command,
    "phase_sin": lambda now: np.sin(now.phase),
    "phase_cos": lambda now: np.cos(now.phase),
}


class Observation:
    """Observations with their history, from the start on.

    Args:
        settings: Terms, scales and history.
        model: MuJoCo model.
    """

    def __init__(self, settings: PolicySettings, model: Any):
        self._settings = settings
        joints = [model.joint(name).id for name in settings.joints]
        self._positions, self._rates = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self._default = np.array(settings.default_joint_pos)
        self._scales = [np.array(getattr(settings.scale, term)) for term in settings.observation]
        kind = mujoco.mjtObj.mjOBJ_SITE if settings.imu else mujoco.mjtObj.mjOBJ_XBODY
        self._imu = int(kind), model.site(settings.imu).id if settings.imu else 1
        self._past = deque[list[Array]](maxlen=max(settings.histories))

    def next(self, model: Any, data: Any, actions: Array, command: Array, seconds: float) -> Array:
        """The next observation; shape (sum of all sizes times their histories,).

        Args:
            model: MuJoCo model.
            data: Its data.
            actions: The actions before; shape (J,).
            command: Commanded velocities; shape (3,).
            seconds: Time since the start [s].
        """
        now = self._moment(model, data, actions, command, seconds)
        terms = zip(self._settings.observation, self._scales, strict=True)
        values = [scale * _VALUES[term](now) for term, scale in terms]
        self._past.extend([values] * (1 if self._past else self._past.maxlen or 1))
        if self._settings.history_by_term:
            lengths = enumerate(self._settings.histories)
            parts = [[past[number] for past in list(self._past)[-length:]] for number, length in lengths]
        else:
            parts = [[np.concatenate(past) for past in self._past]]
        order = -1 if self._settings.newest_first else 1
        return np.concatenate([each for part in parts for each in part[::order]])

    def _moment(self, model: Any, data: Any, actions: Array, command: Array, seconds: float) -> Moment:
        kind, number = self._imu
        velocity = np.empty(6)  # angular first
        mujoco.mj_objectVelocity(model, data, kind, number, velocity, 1)
        rotation = (data.site_xmat if self._settings.imu else data.xmat)[number].reshape(3, 3)
        gravity = model.opt.gravity / np.linalg.norm(model.opt.gravity)
        turns = seconds / self._settings.gait_period + np.array(self._settings.gait_offsets)
        return Moment(
            velocity=velocity.reshape(2, 3)[::-1],
            gravity=gravity @ rotation,
            joint_pos=data.qpos[self._positions] - self._default,
            joint_vel=data.qvel[self._rates],
            actions=actions,
            command=command,
            phase=2 * np.pi * (turns % 1.0),
        )
