"""Equations of motion of the hopper: flight (Eq. 5), stance (Eq. 4), impact (Eq. 8).

Generalised coordinates q = (x, y, α₁, α₂) with the hip at (x, y); the body does not turn. By symmetry
the links couple to the hip only through their first moment S(α₂) along the leg axis, and the α₁–α₂
entry of the mass matrix vanishes. With u(φ) = (sin φ, −cos φ) the Lagrangian (Eq. 1, with the ½ that
the paper leaves out) is

    L = ½ m_x ẋ² + ½ m_y ẏ² + (ẋ, ẏ)·d/dt[S u(α₁)] + ½ A α̇₁² + ½ D α̇₂² − m g y + g S cos α₁,

where m is the total mass, m_x = m + I_z/R² and m_y = m + I_x/R²: the boom adds inertia, not weight.
Every system below reduces to two unknowns, the leg angles: in flight the hip's accelerations are
eliminated, in stance the pinned foot gives them.
"""

from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import compiled
from stepgap.robots.hopper.model.leg import Leg, four_bar, leg_of
from stepgap.robots.hopper.parameters import RobotParameters


class Masses(NamedTuple):
    """Mass properties for compiled code [kg, kg·m, kg·m², m/s²].

    Attributes:
        leg: Link lengths.
        x: m_x, the mass that moves horizontally with the hip.
        y: m_y, the mass that moves vertically with the hip.
        weight: m g.
        gravity: g.
        knee_moment: m₁c₁ + m₂ℓ₁.
        shank_moment: m₂c₂.
        thigh: m₁c₁² + I₁ + m₂ℓ₁².
        shank: m₂c₂² + I₂.
        coupling: m₂ℓ₁c₂.
    """

    leg: Leg
    x: float
    y: float
    weight: float
    gravity: float
    knee_moment: float
    shank_moment: float
    thigh: float
    shank: float
    coupling: float


def masses_of(robot: RobotParameters) -> Masses:
    """The robot's mass properties."""
    mass = robot.body_mass + 2 * robot.top_mass + 2 * robot.bottom_mass
    return Masses(
        leg=leg_of(robot),
        x=mass + robot.boom_inertia_horizontal / robot.boom_length**2,
        y=mass + robot.boom_inertia_vertical / robot.boom_length**2,
        weight=mass * robot.gravity,
        gravity=robot.gravity,
        knee_moment=robot.top_mass * robot.top_com + robot.bottom_mass * robot.top_length,
        shank_moment=robot.bottom_mass * robot.bottom_com,
        thigh=robot.top_mass * robot.top_com**2 + robot.top_inertia + robot.bottom_mass * robot.top_length**2,
        shank=robot.bottom_mass * robot.bottom_com**2 + robot.bottom_inertia,
        coupling=robot.bottom_mass * robot.top_length * robot.bottom_com,
    )


class LegInertia(NamedTuple):
    """First moment S along the leg axis [kg·m], inertias A on α₁ and D on α₂ [kg·m²], and derivatives by α₂."""

    s: float
    d_s: float
    dd_s: float
    a: float
    d_a: float
    d: float
    d_d: float


@compiled
def leg_inertia(masses, bar, alpha_2):
    """`LegInertia` of both halves of the leg together, with `bar` from `four_bar` at α₂."""
    sin_2 = np.sin(alpha_2)
    cos_2 = np.cos(alpha_2)
    sin_k = sin_2 * bar.cos_beta + cos_2 * bar.sin_beta  # knee angle α₂ + β
    cos_k = cos_2 * bar.cos_beta - sin_2 * bar.sin_beta
    b = bar.d_beta
    db = bar.dd_beta
    return LegInertia(
        s=2.0 * (masses.knee_moment * cos_2 + masses.shank_moment * bar.cos_beta),
        d_s=-2.0 * (masses.knee_moment * sin_2 + masses.shank_moment * bar.sin_beta * b),
        dd_s=-2.0 * (masses.knee_moment * cos_2 + masses.shank_moment * (bar.cos_beta * b * b + bar.sin_beta * db)),
        a=2.0 * (masses.thigh + masses.shank + 2.0 * masses.coupling * cos_k),
        d_a=-4.0 * masses.coupling * sin_k * (1.0 + b),
        d=2.0 * (masses.thigh + masses.shank * b * b - 2.0 * masses.coupling * b * cos_k),
        d_d=4.0 * (masses.shank * b * db - masses.coupling * (db * cos_k - b * sin_k * (1.0 + b))),
    )


class Terms(NamedTuple):
    """Entries of M and N in Eq. 2.

    `x_1` is the mass-matrix entry of (ẍ, α̈₁), and so on; `n_x` … `n_2` is N: Coriolis, centrifugal
    and gravity terms, on the left side of the equation.
    """

    x: float
    y: float
    x_1: float
    x_2: float
    y_1: float
    y_2: float
    a: float
    d: float
    n_x: float
    n_y: float
    n_1: float
    n_2: float


@compiled
def terms(masses, bar, alpha_1, alpha_2, rate_1, rate_2):
    """`Terms` of the equations of motion at leg angles [rad] and rates [rad/s]."""
    sin_1 = np.sin(alpha_1)
    cos_1 = np.cos(alpha_1)
    leg = leg_inertia(masses, bar, alpha_2)
    along = leg.dd_s * rate_2**2 - leg.s * rate_1**2
    across = 2.0 * leg.d_s * rate_1 * rate_2
    return Terms(
        x=masses.x,
        y=masses.y,
        x_1=leg.s * cos_1,
        x_2=leg.d_s * sin_1,
        y_1=leg.s * sin_1,
        y_2=-leg.d_s * cos_1,
        a=leg.a,
        d=leg.d,
        n_x=along * sin_1 + across * cos_1,
        n_y=-along * cos_1 + across * sin_1 + masses.weight,
        n_1=leg.d_a * rate_1 * rate_2 + masses.gravity * leg.s * sin_1,
        n_2=0.5 * leg.d_d * rate_2**2 - 0.5 * leg.d_a * rate_1**2 - masses.gravity * leg.d_s * cos_1,
    )


@compiled
def solve_symmetric(a, b, d, p, q):
    """Solves [[a, b], [b, d]] z = (p, q)."""
    inverse = 1.0 / (a * d - b * b)
    return (d * p - b * q) * inverse, (a * q - b * p) * inverse


@compiled
def flight_acceleration(m, torque_1, torque_2):
    """Accelerations (ẍ, ÿ, α̈₁, α̈₂) in flight (Eq. 5), with `m` from `terms` and motor torques [N·m]."""
    x_1 = m.x_1 / m.x
    x_2 = m.x_2 / m.x
    y_1 = m.y_1 / m.y
    y_2 = m.y_2 / m.y
    acc_1, acc_2 = solve_symmetric(
        m.a - x_1 * m.x_1 - y_1 * m.y_1,
        -x_1 * m.x_2 - y_1 * m.y_2,
        m.d - x_2 * m.x_2 - y_2 * m.y_2,
        torque_1 + torque_2 - m.n_1 + x_1 * m.n_x + y_1 * m.n_y,
        torque_1 - torque_2 - m.n_2 + x_2 * m.n_x + y_2 * m.n_y,
    )
    acc_x = -m.n_x / m.x - x_1 * acc_1 - x_2 * acc_2
    acc_y = -m.n_y / m.y - y_1 * acc_1 - y_2 * acc_2
    return acc_x, acc_y, acc_1, acc_2


@compiled
def pinned_mass(m, toe):
    """Mass matrix (a, b, d) on (α₁, α₂) while the foot is pinned: NᵀMN with the null space N of J."""
    a = m.a + m.x * toe.x_1**2 + m.y * toe.y_1**2 - 2.0 * (m.x_1 * toe.x_1 + m.y_1 * toe.y_1)
    d = m.d + m.x * toe.x_2**2 + m.y * toe.y_2**2 - 2.0 * (m.x_2 * toe.x_2 + m.y_2 * toe.y_2)
    b = (
        m.x * toe.x_1 * toe.x_2
        + m.y * toe.y_1 * toe.y_2
        - (m.x_1 * toe.x_2 + m.x_2 * toe.x_1 + m.y_1 * toe.y_2 + m.y_2 * toe.y_1)
    )
    return a, b, d


@compiled
def stance_acceleration(m, toe, rate_1, rate_2, torque_1, torque_2):
    """Accelerations (ẍ, ÿ, α̈₁, α̈₂) and ground force (P_x, P_y) [N] with the foot pinned (Eq. 4).

    Args:
        m: `Terms`.
        toe: `Foot`; the foot's Jacobian is J = [I, ∂r/∂α].
        rate_1: α̇₁ [rad/s].
        rate_2: α̇₂ [rad/s].
        torque_1: Motor torque τ₁ [N·m].
        torque_2: Motor torque τ₂ [N·m].
    """
    c_x = -(2.0 * toe.x_12 * rate_1 * rate_2 + toe.x_22 * rate_2**2 - toe.x * rate_1**2)  # −J̇q̇
    c_y = -(2.0 * toe.y_12 * rate_1 * rate_2 + toe.y_22 * rate_2**2 - toe.y * rate_1**2)
    r_x = m.n_x + m.x * c_x
    r_y = m.n_y + m.y * c_y
    p = torque_1 + torque_2 - m.n_1 - m.x_1 * c_x - m.y_1 * c_y + toe.x_1 * r_x + toe.y_1 * r_y
    q = torque_1 - torque_2 - m.n_2 - m.x_2 * c_x - m.y_2 * c_y + toe.x_2 * r_x + toe.y_2 * r_y
    a, b, d = pinned_mass(m, toe)
    acc_1, acc_2 = solve_symmetric(a, b, d, p, q)
    acc_x = c_x - toe.x_1 * acc_1 - toe.x_2 * acc_2
    acc_y = c_y - toe.y_1 * acc_1 - toe.y_2 * acc_2
    force_x = m.x * acc_x + m.x_1 * acc_1 + m.x_2 * acc_2 + m.n_x
    force_y = m.y * acc_y + m.y_1 * acc_1 + m.y_2 * acc_2 + m.n_y
    return acc_x, acc_y, acc_1, acc_2, force_x, force_y


@compiled
def impact(m, toe, speed_x, speed_y, rate_1, rate_2):
    """Velocities (ẋ, ẏ, α̇₁, α̇₂) after the impact that brings the foot to rest (Eq. 8), from those before."""
    p_x = m.x * speed_x + m.x_1 * rate_1 + m.x_2 * rate_2
    p_y = m.y * speed_y + m.y_1 * rate_1 + m.y_2 * rate_2
    p_1 = m.x_1 * speed_x + m.y_1 * speed_y + m.a * rate_1
    p_2 = m.x_2 * speed_x + m.y_2 * speed_y + m.d * rate_2
    a, b, d = pinned_mass(m, toe)
    after_1, after_2 = solve_symmetric(
        a, b, d, p_1 - toe.x_1 * p_x - toe.y_1 * p_y, p_2 - toe.x_2 * p_x - toe.y_2 * p_y
    )
    after_x = -toe.x_1 * after_1 - toe.x_2 * after_2
    after_y = -toe.y_1 * after_1 - toe.y_2 * after_2
    return after_x, after_y, after_1, after_2


@compiled
def energy(masses, q, qd):
    """Kinetic plus potential energy [J] at configuration q and rate qd; shape (4,) each."""
    bar = four_bar(masses.leg, q[3])
    m = terms(masses, bar, q[2], q[3], qd[2], qd[3])
    kinetic = 0.5 * (m.x * qd[0] ** 2 + m.y * qd[1] ** 2 + m.a * qd[2] ** 2 + m.d * qd[3] ** 2)
    kinetic += qd[0] * (m.x_1 * qd[2] + m.x_2 * qd[3]) + qd[1] * (m.y_1 * qd[2] + m.y_2 * qd[3])
    return kinetic + masses.weight * q[1] - masses.gravity * m.x_1
