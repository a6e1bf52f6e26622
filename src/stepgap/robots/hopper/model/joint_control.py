"""The torque laws of the paper's Sec. 4.1; the model, the twin and the hardware run these same functions.

Motor 1 turns the top link at φ₁ = α₁ + α₂, motor 2 the one at φ₂ = α₁ − α₂, so generalised torques
on (α₁, α₂) are Q = (τ₁ + τ₂, τ₁ − τ₂).
"""

from typing import NamedTuple

from stepgap.base.compiled import compiled
from stepgap.robots.hopper.model.leg import Leg, knee_angle, leg_of
from stepgap.robots.hopper.parameters import Gains, RobotParameters


class JointLaw(NamedTuple):
    """Gains, leg and torque limit for compiled code; attributes as in `Gains`."""

    leg: Leg
    stiffness: float
    rest_length: float
    landing_angle: float
    speed_gain: float
    speed_setpoint: float
    position_gain: float
    damping_gain: float
    torque_limit: float


def joint_law(robot: RobotParameters, gains: Gains) -> JointLaw:
    """Constants of the torque laws.

    Raises:
        ValueError: A length is out of the leg's reach.
    """
    gains.check(robot)
    leg = leg_of(robot)
    return JointLaw(
        leg=leg,
        stiffness=gains.stiffness,
        rest_length=gains.rest_length,
        landing_angle=float(knee_angle(leg, gains.landing_length)),
        speed_gain=gains.speed_gain,
        speed_setpoint=gains.speed_setpoint,
        position_gain=gains.position_gain,
        damping_gain=gains.damping_gain,
        torque_limit=robot.torque_limit,
    )


@compiled
def landing_posture(law, speed):
    """Leg angles (α₁, α₂)_des [rad] that the flight controller holds at a forward speed [m/s]."""
    return law.speed_gain * (speed - law.speed_setpoint), law.landing_angle


@compiled
def flight_torque(law, alpha_1, alpha_2, rate_1, rate_2, speed):
    """Motor torques (τ₁, τ₂) in flight [N·m], before saturation; they hold the landing posture.

    Angles α₁, α₂ [rad], their rates [rad/s], forward speed of the hip [m/s]. The desired rates are
    zero.
    """
    desired_1, desired_2 = landing_posture(law, speed)
    torque_1 = -law.position_gain * (alpha_1 - desired_1) - law.damping_gain * rate_1
    torque_2 = -law.position_gain * (alpha_2 - desired_2) - law.damping_gain * rate_2
    return 0.5 * (torque_1 + torque_2), 0.5 * (torque_1 - torque_2)


@compiled
def stance_torque(law, bar, toe, sin_1, cos_1, force_x, force_y):
    """Motor torques (τ₁, τ₂) in stance [N·m], before saturation.

    The virtual spring F = −K₂(ℓ − ℓ₀) pushes the body along the leg, away from the ground; the step
    command (fx, fy) [N] is added to it. The ground returns this force where τ = −Jᵀ(force on body).

    Args:
        law: `JointLaw`.
        bar: `FourBar` at α₂.
        toe: `Foot` at (α₁, α₂).
        sin_1: sin α₁.
        cos_1: cos α₁.
        force_x: Forward command force, zero before mid-stance.
        force_y: Upward command force, zero before mid-stance.
    """
    spring = -law.stiffness * (bar.length - law.rest_length)
    body_x = -spring * sin_1 + force_x
    body_y = spring * cos_1 + force_y
    torque_1 = -(toe.x_1 * body_x + toe.y_1 * body_y)
    torque_2 = -(toe.x_2 * body_x + toe.y_2 * body_y)
    return 0.5 * (torque_1 + torque_2), 0.5 * (torque_1 - torque_2)
