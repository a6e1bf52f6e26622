"""Control law of the pronk: four legs as one virtual leg (M. H. Raibert, Legged Robots That Balance, 1986, ch. 4).

The virtual leg goes from the middle of the trunk to the middle of the four feet. In stance a spring acts along it, and
from mid-stance on, the step command and a constant thrust are added. Each foot bears a quarter of this force; front
and rear legs differ by a vertical force that holds the pitch. Jᵀ of each leg makes torques of the forces. In flight all
feet are placed below their hips, ahead by a distance that increases with the speed.

Positions are relative to the hip or the middle of the trunk, x forward and z up; angles turn about y, so a positive
pitch is nose down.
"""

from collections import namedtuple
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import compiled
from stepgap.base.ranges import require
from stepgap.mujoco_robots.hopping import FLIGHT, THRUST, phase_after
from stepgap.mujoco_robots.quadruped.model import HIP_X, LINK


@dataclass(frozen=True)
class PronkGains:
    """Gains of the control law.

    Attributes:
        stiffness: Stiffness of the spring of the virtual leg [N/m].
        damping: Damping of the virtual leg [N·s/m].
        rest_length: Its rest length, with which the robot lands [m].
        thrust: Upward force from mid-stance on, which balances the losses of a step [N].
        neutral_time: Distance by which the feet land ahead of the hips, per speed [s].
        speed_gain: Additional distance, per difference of the speed from its setpoint [s].
        speed_setpoint: Speed at which the speed changes least without command [m/s].
        pitch_stiffness: Torque against the pitch in stance [N·m/rad].
        pitch_damping: Torque against its rate [N·m·s/rad].
        retraction: Height by which the feet are raised while the robot rises in flight [m].
        foot_stiffness: Stiffness with which each foot is placed in flight [N/m].
        foot_damping: Damping of this motion [N·s/m].
    """

    stiffness: float = 5000.0
    damping: float = 120.0
    rest_length: float = 0.31
    thrust: float = 320.0
    neutral_time: float = 0.037
    speed_gain: float = 0.04
    speed_setpoint: float = 0.5
    pitch_stiffness: float = 300.0
    pitch_damping: float = 30.0
    retraction: float = 0.03
    foot_stiffness: float = 900.0
    foot_damping: float = 18.0

    def __post_init__(self) -> None:
        for name in ("stiffness", "foot_stiffness", "foot_damping", "pitch_damping"):
            require(getattr(self, name) > 0, name, getattr(self, name), "be positive")
        require(0.15 < self.rest_length < 2 * LINK, "rest_length", self.rest_length, f"lie between 0.15 and {2 * LINK}")

    @property
    def law(self) -> "PronkLaw":
        """These gains for compiled code."""
        return PronkLaw(**vars(self))


PronkLaw = namedtuple("PronkLaw", [gain.name for gain in fields(PronkGains)])  # `PronkGains` for compiled code


class LegPose(NamedTuple):
    """Foot relative to its hip [m], its velocity [m/s], and its derivatives by the angles of thigh and calf.

    `x_1` is ∂x/∂thigh, `z_2` is ∂z/∂calf.
    """

    x: float
    z: float
    x_rate: float
    z_rate: float
    x_1: float
    z_1: float
    x_2: float
    z_2: float


@compiled
def foot_placement(law, speed):
    """Positions of the feet relative to their hips in flight (x, z) [m] at a forward speed [m/s]."""
    x = law.neutral_time * speed + law.speed_gain * (speed - law.speed_setpoint)
    x = min(0.5 * law.rest_length, max(-0.5 * law.rest_length, x))
    return x, -np.sqrt(law.rest_length**2 - x**2)


@compiled
def virtual_force(law, x, z, length_rate, thrusts, force_x, force_z):
    """Force on the trunk (x, z) [N] of the virtual leg in stance.

    Args:
        law: `PronkLaw`.
        x: Foot of the virtual leg relative to the middle of the trunk, forward [m].
        z: The same, upward [m].
        length_rate: Rate of the leg's length [m/s].
        thrusts: Whether mid-stance has passed.
        force_x: Forward force of the command [N].
        force_z: Upward force of the command [N].
    """
    length = np.sqrt(x * x + z * z)
    spring = law.stiffness * (law.rest_length - length) - law.damping * length_rate
    more_x, more_z = (force_x, law.thrust + force_z) if thrusts else (0.0, 0.0)
    return -spring * x / length + more_x, -spring * z / length + more_z


@compiled
def leg_pose(pitch, pitch_rate, thigh, calf, thigh_rate, calf_rate):
    """`LegPose` at joint angles [rad] and rates [rad/s]."""
    upper = pitch + thigh
    lower = pitch + thigh + calf
    upper_rate = pitch_rate + thigh_rate
    lower_rate = pitch_rate + thigh_rate + calf_rate
    x_upper = -np.sin(upper)
    z_upper = -np.cos(upper)
    x_lower = -np.sin(lower)
    z_lower = -np.cos(lower)
    return LegPose(
        x=LINK * (x_upper + x_lower),
        z=LINK * (z_upper + z_lower),
        x_rate=LINK * (z_upper * upper_rate + z_lower * lower_rate),
        z_rate=-LINK * (x_upper * upper_rate + x_lower * lower_rate),
        x_1=LINK * (z_upper + z_lower),
        z_1=-LINK * (x_upper + x_lower),
        x_2=LINK * z_lower,
        z_2=-LINK * x_lower,
    )


@compiled
def pronk(law, phase, contact, position, velocity, command, torques):
    """Computes a tick of the control; returns its phase.

    Args:
        law: `PronkLaw`.
        phase: Phase of the tick before.
        contact: Whether a foot touches the ground.
        position: Generalised positions of the model: x, z, pitch, angles of the legs; shape (11,).
        velocity: Generalised velocities; shape (11,).
        command: Forward and upward force [N]; shape (2,).
        torques: Is filled with the torques of the motors, thigh and calf of each leg; shape (8,) [N·m].
    """
    pitch = position[2]
    rate = velocity[2]
    x = 0.0
    z = 0.0
    x_rate = 0.0
    z_rate = 0.0
    for leg in range(4):  # the hips are symmetric to the middle of the trunk, so it is their mean position
        pose = _leg_pose(position, velocity, leg)
        x = x + pose.x / 4
        z = z + pose.z / 4
        x_rate = x_rate + pose.x_rate / 4
        z_rate = z_rate + pose.z_rate / 4
    length = np.sqrt(x * x + z * z)
    length_rate = (x * x_rate + z * z_rate) / length
    leaves = length >= law.rest_length or not contact
    phase = phase_after(phase, contact and not velocity[1] >= 0.0, length_rate > 0.0, leaves)
    landing_x, landing_z = foot_placement(law, velocity[0])
    landing_z += law.retraction if velocity[1] > 0.0 else 0.0  # so that no foot touches the ground on its way
    body_x, body_z = virtual_force(law, x, z, length_rate, phase == THRUST, command[0], command[1])
    moment = -law.pitch_stiffness * pitch - law.pitch_damping * rate - (z * body_x - x * body_z)
    for leg in range(4):
        pose = _leg_pose(position, velocity, leg)
        end = 1.0 if leg < 2 else -1.0  # front or rear
        if phase == FLIGHT:
            level = landing_z + end * HIP_X * np.sin(pitch)  # so that front and rear feet land together
            foot_x = law.foot_stiffness * (pose.x - landing_x) + law.foot_damping * pose.x_rate
            foot_z = law.foot_stiffness * (pose.z - level) + law.foot_damping * pose.z_rate
        else:
            foot_x = 0.25 * body_x
            foot_z = max(0.0, 0.25 * body_z - end * moment / (4.0 * HIP_X))
        torques[2 * leg] = -(pose.x_1 * foot_x + pose.z_1 * foot_z)  # τ = −Jᵀ F pushes the body with F
        torques[2 * leg + 1] = -(pose.x_2 * foot_x + pose.z_2 * foot_z)
    return phase


@compiled
def _leg_pose(position, velocity, leg):
    """`LegPose` of a leg, by its number."""
    thigh = 3 + 2 * leg
    return leg_pose(
        position[2], velocity[2], position[thigh], position[thigh + 1], velocity[thigh], velocity[thigh + 1]
    )
