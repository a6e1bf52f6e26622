"""The torque laws of the paper's Sec. 4.1; the model, the twin and the hardware run these same functions.

Motor 1 turns the top link at φ₁ = α₁ + α₂, motor 2 the one at φ₂ = α₁ − α₂, so generalised torques
on (α₁, α₂) are Q = (τ₁ + τ₂, τ₁ − τ₂).
"""

from typing import NamedTuple

from stepgap.base.compiled import compiled
from stepgap.robots.hopper.model.leg import Leg, four_bar, knee_angle, leg_of
from stepgap.robots.hopper.parameters import (
    FIRST_EARLY,
    KNOB_UNITS,
    PAPER_COMMAND,
    CommandBounds,
    Gains,
    RobotParameters,
)

(
    FX,
    FY,
    THRUST_REST_LENGTH,
    THRUST_STIFFNESS,
    REST_LENGTH,
    STIFFNESS,
    LANDING_LENGTH,
    SPEED_SETPOINT,
    SPEED_GAIN,
) = range(len(KNOB_UNITS))
"""Numbers of `KNOB_UNITS`, for compiled code."""


class JointLaw(NamedTuple):
    """Gains, leg and torque limit for compiled code; attributes as in `Gains`.

    `knob_1` and `knob_2` are the numbers of what the command is (`KNOB_UNITS`).
    """

    leg: Leg
    stiffness: float
    rest_length: float
    landing_angle: float
    speed_gain: float
    speed_setpoint: float
    position_gain: float
    damping_gain: float
    torque_limit: float
    thrust_rest_length: float
    thrust_stiffness: float
    knob_1: float
    knob_2: float


def joint_law(robot: RobotParameters, gains: Gains, bounds: CommandBounds = PAPER_COMMAND) -> JointLaw:
    """Constants of the torque laws, with what the command is.

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
        thrust_rest_length=gains.thrust_rest_length,
        thrust_stiffness=gains.thrust_stiffness,
        knob_1=float(bounds.knobs[0]),
        knob_2=float(bounds.knobs[1]),
    )


class HopLaws(NamedTuple):
    """The torque laws of one hop under its command.

    Attributes:
        apex: The law without the command, in the ascent.
        landing: In the descent, which begins in its landing posture, and before mid-stance. A robot turns to this
            posture while it falls.
        thrust: From mid-stance to take-off.
        force_x: Forward command force in the thrust [N].
        force_y: Upward command force in the thrust [N].
    """

    apex: JointLaw
    landing: JointLaw
    thrust: JointLaw
    force_x: float
    force_y: float


@compiled
def acts_late(law):
    """Whether the command acts only after mid-stance."""
    return law.knob_1 < FIRST_EARLY and law.knob_2 < FIRST_EARLY


@compiled
def changes_gains(law):
    """Whether the law under a command, or after mid-stance, differs from that without and before."""
    is_force = law.knob_1 <= FY and law.knob_2 <= FY
    return not is_force or law.thrust_stiffness != 0.0 or law.thrust_rest_length != 0.0


@compiled
def _added(law, knob, command_1, command_2):
    """What the command adds to the quantity with a number in `KNOB_UNITS`."""
    return (command_1 if law.knob_1 == knob else 0.0) + (command_2 if law.knob_2 == knob else 0.0)


@compiled
def commanded(law, command_1, command_2):
    """`HopLaws` of a command in the units of its two coordinates; to add zero changes no bit of a law."""
    angle, longer = law.landing_angle, _added(law, LANDING_LENGTH, command_1, command_2)
    if longer != 0.0:
        angle = knee_angle(law.leg, four_bar(law.leg, angle).length + longer)
    landing = _with_spring(
        law,
        _added(law, STIFFNESS, command_1, command_2),
        _added(law, REST_LENGTH, command_1, command_2),
        angle,
        _added(law, SPEED_GAIN, command_1, command_2),
        _added(law, SPEED_SETPOINT, command_1, command_2),
    )
    thrust = _with_spring(
        landing,
        law.thrust_stiffness + _added(law, THRUST_STIFFNESS, command_1, command_2),
        law.thrust_rest_length + _added(law, THRUST_REST_LENGTH, command_1, command_2),
        angle,
        0.0,
        0.0,
    )
    return HopLaws(
        apex=_with_spring(law, 0.0, 0.0, law.landing_angle, 0.0, 0.0),
        landing=landing,
        thrust=thrust,
        force_x=_added(law, FX, command_1, command_2),
        force_y=_added(law, FY, command_1, command_2),
    )


@compiled
def _with_spring(law, stiffer, longer, landing_angle, more_gain, more_speed):
    """`JointLaw` with changes of spring and landing; a copy, since compiled code cannot return a record."""
    return JointLaw(
        leg=Leg(law.leg.top, law.leg.bottom, law.leg.foot),
        stiffness=law.stiffness + stiffer, rest_length=law.rest_length + longer,
        landing_angle=landing_angle, speed_gain=law.speed_gain + more_gain,
        speed_setpoint=law.speed_setpoint + more_speed, position_gain=law.position_gain, damping_gain=law.damping_gain,
        torque_limit=law.torque_limit, thrust_rest_length=law.thrust_rest_length,
        thrust_stiffness=law.thrust_stiffness, knob_1=law.knob_1, knob_2=law.knob_2,
    )  # fmt: skip


@compiled
def lost_command(law, knob, lost_x, lost_y):
    """What limits took away from a coordinate of the command, by the mean force that was lost in the thrust [N].

    A shorter rest length is a force along the leg, which is nearly upright. Of the others none is known.
    """
    if knob == FX:
        return lost_x
    stiffness = law.stiffness + law.thrust_stiffness
    return lost_y if knob == FY else lost_y / stiffness if knob == THRUST_REST_LENGTH else 0.0


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


@compiled
def saturate(torque, limit):
    """Torque limited to ±limit."""
    return min(limit, max(-limit, torque))
