"""Kinematics of the four-bar leg (Sec. 3 and Fig. 1 of the paper).

Angles are measured from the downward vertical, forward positive. The top links stand at α₁ ± α₂, the
bottom links meet at leg length ℓ below the hip along α₁. Every bottom link leans by β against the leg
axis. The foot extends the bottom link of the rear knee by ℓ₃, so it points forward of the axis.

With u(φ) = (sin φ, −cos φ) and n(φ) = du/dφ = (cos φ, sin φ):
    sin β = (ℓ₁/ℓ₂) sin α₂,   ℓ = ℓ₁ cos α₂ + ℓ₂ cos β,   foot − hip = r = ℓ u(α₁) + ℓ₃ u(α₁ + β).
"""

from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import compiled
from stepgap.robots.hopper.parameters import RobotParameters


class Leg(NamedTuple):
    """Link lengths for compiled code [m]."""

    top: float
    bottom: float
    foot: float


def leg_of(robot: RobotParameters) -> Leg:
    """Link lengths of a robot."""
    return Leg(robot.top_length, robot.bottom_length, robot.foot_length)


class FourBar(NamedTuple):
    """Leg length ℓ [m] and bottom link angle β [rad] at a given α₂, with derivatives by α₂.

    `d` is the first derivative, `dd` the second.
    """

    length: float
    d_length: float
    dd_length: float
    sin_beta: float
    cos_beta: float
    d_beta: float
    dd_beta: float


class Foot(NamedTuple):
    """Foot relative to the hip r = (x, y) [m], and its derivatives by α₁ and α₂.

    `x_1` is ∂x/∂α₁ and `x_12` is ∂²x/∂α₁∂α₂; ∂²r/∂α₁² = −r.
    """

    x: float
    y: float
    x_1: float
    y_1: float
    x_2: float
    y_2: float
    x_12: float
    y_12: float
    x_22: float
    y_22: float


@compiled
def four_bar(leg, alpha_2):
    """`FourBar` at half the angle between the top links α₂ [rad]."""
    sin_2 = np.sin(alpha_2)
    cos_2 = np.cos(alpha_2)
    ratio = leg.top / leg.bottom
    sin_beta = ratio * sin_2
    cos_beta = np.sqrt(1.0 - sin_beta * sin_beta)
    secant = 1.0 / cos_beta
    d_beta = ratio * cos_2 * secant
    dd_beta = sin_beta * (d_beta * d_beta - 1.0) * secant
    return FourBar(
        length=leg.top * cos_2 + leg.bottom * cos_beta,
        d_length=-leg.top * sin_2 * (1.0 + d_beta),
        dd_length=-leg.top * (cos_2 * (1.0 + d_beta) + sin_2 * dd_beta),
        sin_beta=sin_beta,
        cos_beta=cos_beta,
        d_beta=d_beta,
        dd_beta=dd_beta,
    )


@compiled
def foot(leg, bar, alpha_1):
    """`Foot` at leg angle α₁ [rad], with `bar` from `four_bar` at α₂."""
    sin_1 = np.sin(alpha_1)
    cos_1 = np.cos(alpha_1)
    sin_f = sin_1 * bar.cos_beta + cos_1 * bar.sin_beta
    cos_f = cos_1 * bar.cos_beta - sin_1 * bar.sin_beta
    toe = leg.foot
    return Foot(
        x=bar.length * sin_1 + toe * sin_f,
        y=-bar.length * cos_1 - toe * cos_f,
        x_1=bar.length * cos_1 + toe * cos_f,
        y_1=bar.length * sin_1 + toe * sin_f,
        x_2=bar.d_length * sin_1 + toe * bar.d_beta * cos_f,
        y_2=-bar.d_length * cos_1 + toe * bar.d_beta * sin_f,
        x_12=bar.d_length * cos_1 - toe * bar.d_beta * sin_f,
        y_12=bar.d_length * sin_1 + toe * bar.d_beta * cos_f,
        x_22=bar.dd_length * sin_1 + toe * (bar.dd_beta * cos_f - bar.d_beta**2 * sin_f),
        y_22=-bar.dd_length * cos_1 + toe * (bar.dd_beta * sin_f + bar.d_beta**2 * cos_f),
    )


@compiled
def knee_angle(leg, length):
    """α₂ [rad] at leg length ℓ [m], by the law of cosines: the inverse of `four_bar`."""
    cosine = (leg.top**2 + length**2 - leg.bottom**2) / (2.0 * leg.top * length)
    return np.arccos(min(1.0, max(-1.0, cosine)))
