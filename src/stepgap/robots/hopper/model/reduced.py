"""Reduced motion: the leg's motion determines the hip's, so there are four states instead of eight, exactly.

The state is (α₁, α₂, α̇₁, α̇₂). In flight gravity is the only external force, so with the terms x_1 … y_2 of the mass
matrix (`dynamics.Terms`) and the first moment S of the leg

    m_x ẋ + x_1 α̇₁ + x_2 α̇₂ = p_x,   m_y ẏ + y_1 α̇₁ + y_2 α̇₂ = p_y − m g t,   m_y y − S cos α₁ = z + p_y t − ½ m g t²

give the hip's ẋ, ẏ and y, where t counts from the start of the flight. In stance the foot rests at the origin, so
r(α₁, α₂) of `leg.foot` gives the hip. A motor that saturates gives its limit until its law asks for less: within a
piece, `Flight` or `Stance`, each motor's mode is fixed, so that all functions here are smooth.
"""

from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import compiled, inlined
from stepgap.robots.hopper.model.dynamics import Masses, flight_acceleration, stance_acceleration, terms
from stepgap.robots.hopper.model.joint_control import JointLaw, flight_torque, stance_torque
from stepgap.robots.hopper.model.leg import foot, four_bar

STRETCH_ANGLE = 0.02  # α₂ at which the leg counts as fully stretched [rad]
LEAN_ANGLE = 1.0  # |α₁| at which the robot counts as fallen [rad]
FOLD_ANGLE = 2.5  # α₂ at which the leg has collapsed [rad]


class Flight(NamedTuple):
    """Constants of a piece of flight.

    Attributes:
        masses: Mass properties.
        law: Torque laws.
        side: Sign of ẏ, ±1.
        depth: Depth below the ground at which the foot counts as touching it [m].
        momentum_x: p_x [kg·m/s].
        momentum_y: p_y at the start [kg·m/s].
        moment_y: z, m_y y − S cos α₁ at the start [kg·m].
        mode_1: 0 while motor 1 obeys its law, ±1 while it saturates at ±limit.
        mode_2: The same for motor 2.
    """

    masses: Masses
    law: JointLaw
    side: float
    depth: float
    momentum_x: float
    momentum_y: float
    moment_y: float
    mode_1: float
    mode_2: float


class Stance(NamedTuple):
    """Constants of a piece of stance.

    Attributes:
        masses: Mass properties.
        law: Torque laws.
        side: Sign of ẏ, ±1.
        force_x: Forward command force [N]; zero before mid-stance.
        force_y: Upward command force [N]; zero before mid-stance.
        mode_1: 0 while motor 1 obeys its law, ±1 while it saturates at ±limit.
        mode_2: The same for motor 2.
    """

    masses: Masses
    law: JointLaw
    side: float
    force_x: float
    force_y: float
    mode_1: float
    mode_2: float


class Hip(NamedTuple):
    """Height y [m] and velocity ẋ, ẏ [m/s] of the hip."""

    height: float
    speed_x: float
    speed_y: float


@compiled
def limited(torque, mode, limit):
    """Torque of a motor in a mode [N·m]."""
    return torque if mode == 0.0 else mode * limit


@compiled
def flight_of(masses, law, side, depth, hip, state):
    """`Flight` that starts with this motion of hip and leg, both motors obeying their laws."""
    m = terms(masses, four_bar(masses.leg, state[1]), state[0], state[1], state[2], state[3])
    return Flight(
        masses=masses,
        law=law,
        side=side,
        depth=depth,
        momentum_x=m.x * hip.speed_x + m.x_1 * state[2] + m.x_2 * state[3],
        momentum_y=m.y * hip.speed_y + m.y_1 * state[2] + m.y_2 * state[3],
        moment_y=m.y * hip.height - m.x_1,
        mode_1=0.0,
        mode_2=0.0,
    )


@compiled
def hip_in_flight(system, m, time, state):
    """`Hip` at a time since the start of the flight, with `m` from `terms`."""
    fall = system.masses.weight * time
    return Hip(
        (system.moment_y + (system.momentum_y - 0.5 * fall) * time + m.x_1) / m.y,
        (system.momentum_x - m.x_1 * state[2] - m.x_2 * state[3]) / m.x,
        (system.momentum_y - fall - m.y_1 * state[2] - m.y_2 * state[3]) / m.y,
    )


@compiled
def hip_in_stance(toe, state):
    """`Hip` over a foot that rests at the origin, with `toe` from `leg.foot`."""
    return Hip(-toe.y, -toe.x_1 * state[2] - toe.x_2 * state[3], -toe.y_1 * state[2] - toe.y_2 * state[3])


@inlined
def flight_motion(system, time, state):
    """(rate, hip, clearance of the foot [m], torques that the law asks for [N·m]) in flight."""
    bar = four_bar(system.masses.leg, state[1])
    m = terms(system.masses, bar, state[0], state[1], state[2], state[3])
    hip = hip_in_flight(system, m, time, state)
    limit = system.law.torque_limit
    torque_1, torque_2 = flight_torque(system.law, state[0], state[1], state[2], state[3], hip.speed_x)
    acceleration = flight_acceleration(
        m, limited(torque_1, system.mode_1, limit), limited(torque_2, system.mode_2, limit)
    )
    clearance = hip.height + foot(system.masses.leg, bar, state[0]).y
    return (state[2], state[3], acceleration[2], acceleration[3]), hip, clearance, (torque_1, torque_2)


@inlined
def stance_motion(system, state):
    """(rate, hip, upward ground force [N], torques that the law asks for [N·m]) in stance."""
    bar = four_bar(system.masses.leg, state[1])
    toe = foot(system.masses.leg, bar, state[0])
    m = terms(system.masses, bar, state[0], state[1], state[2], state[3])
    sin_1 = np.sin(state[0])
    cos_1 = np.cos(state[0])
    torque_1, torque_2 = stance_torque(system.law, bar, toe, sin_1, cos_1, system.force_x, system.force_y)
    limit = system.law.torque_limit
    torques = limited(torque_1, system.mode_1, limit), limited(torque_2, system.mode_2, limit)
    motion = stance_acceleration(m, toe, state[2], state[3], torques[0], torques[1])
    rate = (state[2], state[3], motion[2], motion[3])
    return rate, hip_in_stance(toe, state), motion[5], (torque_1, torque_2)


@compiled
def uprightness(leg, height, alpha_1, alpha_2):
    """Guard that is positive until the robot has fallen: a knee touches the ground, or the leg leans or folds too far.

    Takes the hip height [m] and the leg angles [rad].
    """
    return min(height - leg.top, LEAN_ANGLE - abs(alpha_1), FOLD_ANGLE - alpha_2)


@compiled
def piece_guards(system, contact, hip, state, torques):
    """Guards, positive within a piece: contact, ±ẏ, uprightness, bend of the leg, mode of either motor."""
    return (
        *body_guards(system, contact, hip, state),
        _motor_guard(torques[0], system.mode_1, system.law.torque_limit),
        _motor_guard(torques[1], system.mode_2, system.law.torque_limit),
    )


@compiled
def body_guards(system, contact, hip, state):
    """Guards that do not depend on the motors, positive within a piece: contact, ±ẏ, uprightness, bend of the leg."""
    upright = uprightness(system.masses.leg, hip.height, state[0], state[1])
    return contact, system.side * hip.speed_y, upright, state[1] - STRETCH_ANGLE


@compiled
def _motor_guard(torque, mode, limit):
    return 1.0 - (torque / limit) ** 2 if mode == 0.0 else mode * torque / limit - 1.0
