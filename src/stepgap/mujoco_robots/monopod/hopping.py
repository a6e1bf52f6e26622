"""Control law of the monopod in three parts (M. H. Raibert, Legged Robots That Balance, 1986, ch. 3).

In flight the leg points to where the foot is to land: ahead of the hip by the neutral point of the velocity, by a share
of the velocity, and by the command. In stance the leg is a spring, which from mid-stance on pushes with a thrust and
with the command, and the hip turns the body upright. Forward and to the left are directions of the ground, whatever
the heading of the body.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import compiled
from stepgap.base.ranges import require
from stepgap.mujoco_robots.monopod.model import LEG

IN_FLIGHT, IN_COMPRESSION, IN_THRUST = 0, 1, 2
"""Phases of a step."""

LONGEST_STRIDE = 0.6 * LEG
"""Largest horizontal distance of the foot from the hip that is commanded [m]."""


@dataclass(frozen=True)
class HoppingGains:
    """Gains of the control law.

    Attributes:
        stiffness: Stiffness of the leg [N/m].
        damping: Damping of the leg in stance [N·s/m].
        flight_damping: Damping of the leg in flight [N·s/m].
        thrust: Force from mid-stance on that balances the losses of a step [N].
        neutral_time: Distance by which the foot lands ahead of the hip for a velocity that stays, per velocity [s].
        velocity_gain: Additional distance per velocity, which slows the robot down [s].
        attitude_stiffness: Torque against the tilt of the body in stance [N·m/rad].
        attitude_damping: Torque against its rate [N·m·s/rad].
        swing_stiffness: Torque that swings the leg in flight [N·m/rad].
        swing_damping: Damping of this motion [N·m·s/rad].
    """

    stiffness: float = 3500.0
    damping: float = 10.0
    flight_damping: float = 40.0
    thrust: float = 60.0
    neutral_time: float = 0.085
    velocity_gain: float = 0.03
    attitude_stiffness: float = 150.0
    attitude_damping: float = 15.0
    swing_stiffness: float = 100.0
    swing_damping: float = 8.0

    def __post_init__(self) -> None:
        for name in ("stiffness", "attitude_damping", "swing_stiffness", "swing_damping"):
            require(getattr(self, name) > 0, name, getattr(self, name), "be positive")

    @property
    def law(self) -> "HoppingLaw":
        """These gains for compiled code."""
        return HoppingLaw(**vars(self))


class HoppingLaw(NamedTuple):
    """`HoppingGains` for compiled code."""

    stiffness: float
    damping: float
    flight_damping: float
    thrust: float
    neutral_time: float
    velocity_gain: float
    attitude_stiffness: float
    attitude_damping: float
    swing_stiffness: float
    swing_damping: float


@compiled
def body_rotation(quaternion):
    """Rotation matrix (3, 3) from the body to the world of a unit quaternion w, x, y, z."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@compiled
def tilt(turned):
    """Roll and pitch of a rotation matrix [rad]; nose down is positive."""
    return np.arctan2(turned[2, 1], turned[2, 2]), -np.arcsin(turned[2, 0])


@compiled
def hip_angles(law, turned, velocity_x, velocity_y, foot_x, foot_y):
    """Roll and pitch of the hip [rad] with which the foot points to where it is to land.

    Args:
        law: `HoppingLaw`.
        turned: Rotation matrix from the body to the world.
        velocity_x: Forward velocity [m/s].
        velocity_y: Velocity to the left [m/s].
        foot_x: Additional distance of the command, forward [m].
        foot_y: The same, to the left [m].
    """
    gain = law.neutral_time + law.velocity_gain
    x, y = gain * velocity_x + foot_x, gain * velocity_y + foot_y
    shrunk = min(1.0, LONGEST_STRIDE / max(np.sqrt(x * x + y * y), 1e-9))
    x, y = x * shrunk, y * shrunk
    z = -np.sqrt(LEG * LEG - x * x - y * y)
    along_x, along_y, along_z = turned.T @ np.array([x, y, z])
    return np.arctan2(along_y, -along_z), -np.arcsin(min(1.0, max(-1.0, along_x / LEG)))


@compiled
def hopping_phase(phase, extension, extension_rate, falls, contact):
    """Phase of this tick, from that of the tick before and how far the leg is extended [m], with its rate [m/s]."""
    if phase == IN_FLIGHT and contact and falls:
        phase = IN_COMPRESSION
    if phase == IN_COMPRESSION and extension_rate > 0.0:
        phase = IN_THRUST
    if phase == IN_THRUST and (extension >= 0.0 or not contact):
        phase = IN_FLIGHT
    return phase


@compiled
def hopping(law, phase, contact, position, velocity, command, efforts):
    """Computes a tick of the control; returns its phase.

    Args:
        law: `HoppingLaw`.
        phase: Phase of the tick before.
        contact: Whether the foot touches the ground.
        position: Generalised positions of the model: place, quaternion, roll and pitch of the hip, leg; shape (10,).
        velocity: Generalised velocities, those of the body's rotation in its own frame; shape (9,).
        command: Distances of the foot forward and to the left [m], and force of the leg [N]; shape (3,).
        efforts: Is filled with the torques of the hip [N·m] and the force of the leg [N]; shape (3,).
    """
    turned = body_rotation(position[3:7])
    extension, rate = position[9], velocity[8]
    phase = hopping_phase(phase, extension, rate, velocity[2] < 0.0, contact)
    if phase == IN_FLIGHT:
        roll, pitch = hip_angles(law, turned, velocity[0], velocity[1], command[0], command[1])
        efforts[0] = law.swing_stiffness * (roll - position[7]) - law.swing_damping * velocity[6]
        efforts[1] = law.swing_stiffness * (pitch - position[8]) - law.swing_damping * velocity[7]
        efforts[2] = -law.stiffness * extension - law.flight_damping * rate
    else:
        roll, pitch = tilt(turned)  # the hip turns the body against the leg, which stands
        efforts[0] = law.attitude_stiffness * roll + law.attitude_damping * velocity[3]
        efforts[1] = law.attitude_stiffness * pitch + law.attitude_damping * velocity[4]
        efforts[2] = -law.stiffness * extension - law.damping * rate
        if phase == IN_THRUST:
            efforts[2] += law.thrust + command[2]
    return phase
