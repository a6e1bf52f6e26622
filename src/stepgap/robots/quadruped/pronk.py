"""Control law of the pronk: four legs as one virtual leg (M. H. Raibert, Legged Robots That Balance, 1986, ch. 4).

The virtual leg goes from the middle of the trunk to the middle of the four feet. In stance a spring acts along it, and
from mid-stance on, the step command and a constant thrust are added. Each foot bears a quarter of this force; front
and rear legs differ by a vertical force that holds the pitch. Jᵀ of each leg makes torques of the forces. In flight all
feet are placed below their hips, ahead by a distance that increases with the speed.

Left and right legs move together, so a leg of each end represents both. Positions are relative to the hip or the middle
of the trunk, x forward and z up; angles turn about y, so a positive pitch is nose down.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import compiled
from stepgap.base.ranges import require
from stepgap.robots.quadruped.model import HIP_X, LINK

FLIGHT, COMPRESSION, THRUST = 0, 1, 2
"""Phases of a step."""

FRONT, REAR = 3, 7
"""Indices of the thigh angles of a front and a rear leg in the positions of the model; the calf's angle follows."""


@dataclass(frozen=True)
class PronkGains:
    """Gains of the control law.

    Attributes:
        stiffness: Stiffness of the spring of the virtual leg [N/m].
        rest_length: Its rest length, with which the robot lands [m].
        thrust: Upward force from mid-stance on, which balances the losses of a step [N].
        neutral_time: Distance by which the feet land ahead of the hips, per speed [s].
        speed_gain: Additional distance, per difference of the speed from its setpoint [s].
        speed_setpoint: Speed at which the speed changes least without command [m/s].
        pitch_stiffness: Torque against the pitch in stance [N·m/rad].
        pitch_damping: Torque against its rate [N·m·s/rad].
        foot_stiffness: Stiffness with which each foot is placed in flight [N/m].
        foot_damping: Damping of this motion [N·s/m].
    """

    stiffness: float = 5000.0
    rest_length: float = 0.31
    thrust: float = 130.0
    neutral_time: float = 0.045
    speed_gain: float = 0.04
    speed_setpoint: float = 0.5
    pitch_stiffness: float = 150.0
    pitch_damping: float = 10.0
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


class PronkLaw(NamedTuple):
    """`PronkGains` for compiled code."""

    stiffness: float
    rest_length: float
    thrust: float
    neutral_time: float
    speed_gain: float
    speed_setpoint: float
    pitch_stiffness: float
    pitch_damping: float
    foot_stiffness: float
    foot_damping: float


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
def landing_place(law, speed):
    """Place of the feet relative to their hips in flight (x, z) [m] at a forward speed [m/s]."""
    x = law.neutral_time * speed + law.speed_gain * (speed - law.speed_setpoint)
    x = min(0.5 * law.rest_length, max(-0.5 * law.rest_length, x))
    return x, -np.sqrt(law.rest_length**2 - x**2)


@compiled
def virtual_force(law, x, z, thrusts, force_x, force_z):
    """Force on the trunk (x, z) [N] of the virtual leg in stance.

    Args:
        law: `PronkLaw`.
        x: Foot of the virtual leg relative to the middle of the trunk, forward [m].
        z: The same, upward [m].
        thrusts: Whether mid-stance has passed.
        force_x: Forward force of the command [N].
        force_z: Upward force of the command [N].
    """
    length = np.sqrt(x * x + z * z)
    spring = law.stiffness * (law.rest_length - length)
    more_x, more_z = (force_x, law.thrust + force_z) if thrusts else (0.0, 0.0)
    return -spring * x / length + more_x, -spring * z / length + more_z


@compiled
def leg_pose(pitch, pitch_rate, thigh, calf, thigh_rate, calf_rate):
    """`LegPose` at joint angles [rad] and rates [rad/s]."""
    upper, lower = pitch + thigh, pitch + thigh + calf
    upper_rate, lower_rate = pitch_rate + thigh_rate, pitch_rate + thigh_rate + calf_rate
    x_upper, z_upper, x_lower, z_lower = -np.sin(upper), -np.cos(upper), -np.sin(lower), -np.cos(lower)
    return LegPose(
        LINK * (x_upper + x_lower),
        LINK * (z_upper + z_lower),
        LINK * (z_upper * upper_rate + z_lower * lower_rate),
        -LINK * (x_upper * upper_rate + x_lower * lower_rate),
        LINK * (z_upper + z_lower),
        -LINK * (x_upper + x_lower),
        LINK * z_lower,
        -LINK * x_lower,
    )


@compiled
def next_phase(law, phase, length, length_rate, rises, contact):
    """Phase of this tick, from that of the tick before and the virtual leg's length [m] and its rate [m/s]."""
    if phase == FLIGHT and contact and not rises:
        phase = COMPRESSION
    if phase == COMPRESSION and length_rate > 0.0:
        phase = THRUST
    if phase == THRUST and (length >= law.rest_length or not contact):
        phase = FLIGHT
    return phase


@compiled
def pronk(law, phase, contact, position, velocity, force_x, force_z, torques):
    """Computes a tick of the control; returns its phase.

    Args:
        law: `PronkLaw`.
        phase: Phase of the tick before.
        contact: Whether a foot touches the ground.
        position: Generalised positions of the model: x, z, pitch, angles of the legs; shape (11,).
        velocity: Generalised velocities; shape (11,).
        force_x: Forward force of the command [N].
        force_z: Upward force of the command [N].
        torques: Is filled with the torques of the motors, thigh and calf of each leg; shape (8,) [N·m].
    """
    pitch, rate = position[2], velocity[2]
    front = leg_pose(pitch, rate, position[FRONT], position[FRONT + 1], velocity[FRONT], velocity[FRONT + 1])
    rear = leg_pose(pitch, rate, position[REAR], position[REAR + 1], velocity[REAR], velocity[REAR + 1])
    # the hips are symmetric to the middle of the trunk, so the virtual foot is the mean of the feet relative to them
    x, z = 0.5 * (front.x + rear.x), 0.5 * (front.z + rear.z)
    length = np.sqrt(x * x + z * z)
    length_rate = 0.5 * (x * (front.x_rate + rear.x_rate) + z * (front.z_rate + rear.z_rate)) / length
    phase = next_phase(law, phase, length, length_rate, velocity[1] >= 0.0, contact)
    if phase == FLIGHT:
        place_x, place_z = landing_place(law, velocity[0])
        _place(law, front, place_x, place_z, torques[0:4])
        _place(law, rear, place_x, place_z, torques[4:8])
        return phase
    body_x, body_z = virtual_force(law, x, z, phase == THRUST, force_x, force_z)
    moment = -law.pitch_stiffness * pitch - law.pitch_damping * rate - (z * body_x - x * body_z)
    more_rear = moment / (4.0 * HIP_X)
    _push(front, 0.25 * body_x, max(0.0, 0.25 * body_z - more_rear), torques[0:4])
    _push(rear, 0.25 * body_x, max(0.0, 0.25 * body_z + more_rear), torques[4:8])
    return phase


@compiled
def _place(law, leg, x, z, torques):
    """Torques of two legs in flight that move their feet to a place relative to the hips."""
    force_x = law.foot_stiffness * (x - leg.x) - law.foot_damping * leg.x_rate
    force_z = law.foot_stiffness * (z - leg.z) - law.foot_damping * leg.z_rate
    _push(leg, -force_x, -force_z, torques)


@compiled
def _push(leg, force_x, force_z, torques):
    """Torques of two legs in stance, each of which pushes the body with a force: τ = −Jᵀ F."""
    torques[0] = torques[2] = -(leg.x_1 * force_x + leg.z_1 * force_z)
    torques[1] = torques[3] = -(leg.x_2 * force_x + leg.z_2 * force_z)
