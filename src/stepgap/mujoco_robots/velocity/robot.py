"""The robot `velocity`: a walking quadruped with the built-in trot, or any robot behind the plant `process`.

In a trot diagonal legs step together, and all feet move as the commanded velocity of the body demands. In stance a foot
goes back under the body with the opposite of the commanded velocity of its hip; in flight it goes forward to where half
of the next stance will be before it and half behind, displaced where the body is faster than it is told (M. H. Raibert,
Legged Robots That Balance, 1986). Feet in stance press harder on the side to which the body is tilted. A slow command
is not walked at all, as by many robots. The trot does not correct its velocity: slipping feet, yielding servos, slopes
and loads change it.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from dataclasses import dataclass, field
from math import inf
from typing import Any, final

import mujoco
import numpy as np
from numpy.typing import NDArray

from stepgap.base.ranges import require
from stepgap.mujoco_robots.quadruped.model import (
    CALF_TORQUE,
    HIP_Y,
    LEGS,
    LINK,
    THIGH_OFFSET,
    THIGH_TORQUE,
    TOE_RADIUS,
    leg_xml,
    machine_xml,
)
from stepgap.mujoco_robots.velocity.walking_robot import WalkingControl, WalkingRobot, body_velocity
from stepgap.step import Array

_TORQUES = {"hip": THIGH_TORQUE, "thigh": THIGH_TORQUE, "calf": CALF_TORQUE}


def walker_xml(stiffness: float, damping: float) -> str:
    """The machine of `quadruped/model.py`, free, with twelve servos.

    Its joints are a free one, and `LEG_hip`, `LEG_thigh` and `LEG_calf` of each leg, in this order.

    Args:
        stiffness: Stiffness of the position servos [N·m/rad].
        damping: Their damping [N·m·s/rad].
    """
    legs = "".join(
        leg_xml(leg, f'<joint name="{leg.name}_hip" class="leg" axis="1 0 0"/>', thigh_y=-0.0223) for leg in LEGS
    )
    servos = "".join(
        f'<position name="{leg.name}_{link}" joint="{leg.name}_{link}" kp="{stiffness}" kv="{damping}"'
        f' forcerange="-{most} {most}"/>'
        for leg in LEGS
        for link, most in _TORQUES.items()
    )
    option = 'timestep="0.002" impratio="10"'
    return machine_xml("walker", option, "100 100 0.1", 0.3, '<freejoint name="trunk"/>', legs, servos)


_SIDES = np.array([1.0 if leg.y > 0 else -1.0 for leg in LEGS])
_HIPS = np.array([[leg.x, np.sign(leg.y) * HIP_Y] for leg in LEGS])
_FEET = np.array([[leg.x, leg.y] for leg in LEGS])
"""Places of the hips, and of the feet of a robot that stands, in the frame of the trunk; shape (4, 2) [m]."""
_AHEAD = np.array([0.0 if (leg.x > 0) == (leg.y > 0) else 0.5 for leg in LEGS])
"""Part of the period by which each leg is ahead."""


@dataclass(frozen=True)
class TrotGains:
    """The gait.

    Attributes:
        period: Time in which each foot is lifted once [s].
        stance: Part of the period in which a foot is on the ground.
        height: Height of the hips above the feet [m].
        lift: Height by which a foot is lifted [m].
        dead_band: Speed of the feet below which the robot stands [m/s].
        lag: Time constant with which the gait follows a new command [s].
        placement: Distance by which a foot lands further out, per velocity that is too large [s].
        levelling: Part of its tilt by which the feet in stance level the body.
        stiffness: Stiffness of the position servos [N·m/rad].
        damping: Damping of the position servos [N·m·s/rad].
    """

    period: float = 0.25
    stance: float = 0.6
    height: float = 0.29
    lift: float = 0.05
    dead_band: float = 0.05
    lag: float = 0.08
    placement: float = 0.08
    levelling: float = 0.5
    stiffness: float = 150.0
    damping: float = 3.0

    def __post_init__(self) -> None:
        for name in ("period", "lag", "stiffness"):
            require(0 < getattr(self, name) < inf, name, getattr(self, name), "be positive and finite")
        require(0.3 <= self.stance <= 0.9, "stance", self.stance, "lie from 0.3 to 0.9")
        require(0.15 < self.height < 2 * LINK - 0.05, "height", self.height, f"lie between 0.15 and {2 * LINK - 0.05}")


@final
class Trot(WalkingControl):
    """The gait of a `TrotGains`."""

    period = 0.01

    def __init__(self, gains: TrotGains):
        self._gains = gains
        self._rest()

    def _rest(self) -> None:
        self._walks = False
        self._velocity = np.zeros(3)
        self._phase = 0.0
        self._placed = np.zeros((4, 2))

    def start(self, model: Any, data: Any) -> None:  # noqa: ARG002
        """At rest."""
        self._rest()

    def control(self, model: Any, data: Any, command: Array) -> Array:  # noqa: ARG002
        """Angles of the joints; shape (12,)."""
        gains = self._gains
        moves = np.linalg.norm(_velocities_of_feet(command), axis=1).max() > gains.dead_band
        self._velocity = self._velocity + (moves * command - self._velocity) * self.period / gains.lag
        phases = (self._phase + _AHEAD) % 1.0
        swings = phases >= gains.stance
        self._walks = bool(moves or (self._walks and swings.any()))  # a foot in flight comes down first
        if not self._walks:
            self._rest()
            return joint_angles(self._feet(np.zeros((4, 2)), np.zeros(4), ~swings, data))
        self._phase = (self._phase + self.period / gains.period) % 1.0
        share = np.where(swings, phases - gains.stance, phases) / np.where(swings, 1 - gains.stance, gains.stance)
        smooth = share - np.sin(2 * np.pi * share) / (2 * np.pi)
        excess = gains.placement * _velocities_of_feet(body_velocity(data) - self._velocity)
        self._placed += (swings * smooth)[:, None] * (excess - self._placed)
        stride = gains.stance * gains.period * _velocities_of_feet(self._velocity)
        along = np.where(swings, smooth - 0.5, 0.5 - share)
        lift = gains.lift * np.where(swings, np.sin(np.pi * share) ** 2, 0.0)
        return joint_angles(self._feet(along[:, None] * stride + self._placed, lift, ~swings, data))

    def _feet(self, moved: Array, lift: Array, stands: NDArray[np.bool_], data: Any) -> Array:
        """Places of the feet relative to their hips: moved (4, 2) and lifted (4,); shape (4, 3)."""
        gains = self._gains
        roll, pitch = _tilt(data)
        level = gains.levelling * (pitch * _FEET[:, 0] - roll * _FEET[:, 1])
        height = lift - gains.height - np.where(stands, level, 0.0)
        return np.column_stack([_FEET - _HIPS + moved, height])


def _velocities_of_feet(velocity: Array) -> Array:
    """Velocities of the body above its feet; shape (4, 2)."""
    forward, left, turn = velocity
    return np.array([forward, left]) + turn * np.column_stack([-_FEET[:, 1], _FEET[:, 0]])


def _tilt(data: Any) -> tuple[float, float]:
    """Roll (left side up) and pitch (nose down) of the body, to first order [rad]."""
    w, x, y, z = data.qpos[3:7]
    return 2 * (w * x + y * z), 2 * (w * y - x * z)


def joint_angles(feet: Array) -> Array:
    """Angles of hip, thigh and calf of each leg with which its foot is at a place; out of reach, in its direction.

    Args:
        feet: Places relative to the axes of the hips: forward, left, up; shape (4, 3) [m].

    Returns:
        Shape (12,) [rad].
    """
    x, y, z = feet.T
    below = np.sqrt(np.maximum(y * y + z * z - THIGH_OFFSET**2, 1e-4))
    hip = np.arctan2(z, y) - np.arctan2(-below, _SIDES * THIGH_OFFSET)
    hip = (hip + np.pi) % (2 * np.pi) - np.pi
    bend = np.arccos(np.minimum(np.hypot(x, below) / (2 * LINK), 1.0))
    return np.column_stack([hip, np.arctan2(-x, below) + bend, -2 * bend]).ravel()


def standing(gains: TrotGains) -> Array:
    """Angles of the joints of a robot that stands; shape (12,) [rad]."""
    return joint_angles(np.column_stack([_FEET - _HIPS, np.full(4, -gains.height)]))


@dataclass(frozen=True)
class TrottingRobot(WalkingRobot):
    """A quadruped that trots at a commanded velocity.

    Attributes:
        gait: The gait.
    """

    gait: TrotGains = field(default_factory=TrotGains)

    name = "velocity"

    def mjcf_spec(self) -> Any:
        """The quadruped with position servos."""
        return mujoco.MjSpec.from_string(walker_xml(self.gait.stiffness, self.gait.damping))

    def stand(self, model: Any, data: Any) -> None:  # noqa: ARG002
        """All feet on the ground, below their hips."""
        data.ctrl[:] = standing(self.gait)
        data.qpos[2] = self.gait.height + TOE_RADIUS
        data.qpos[7:] = data.ctrl

    def walking_control(self) -> Trot:
        """The trot."""
        return Trot(self.gait)
