"""Measured motion of leg and hip at one tick: angles from counts, their rates, and the sample of the flight."""

from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import as_written, compiled
from stepgap.robots.hopper.model.dynamics import leg_inertia
from stepgap.robots.hopper.model.leg import foot, four_bar
from stepgap.robots.hopper.tick.estimator import NO_SAMPLES, apex_passed, with_reading, with_sample
from stepgap.robots.hopper.tick.hop_state import FlightState
from stepgap.robots.hopper.tick.phases import Phase, next_phase
from stepgap.robots.hopper.tick.safety import JointMotion

_TURN = 2.0 * np.pi


class Body(NamedTuple):
    """Measured motion of the hip, in addition to `JointMotion`.

    Attributes:
        x: Distance travelled [m].
        yaw: Yaw of the boom [rad].
        hip_rate: ẏ of the hip if the foot is at rest [m/s].
        shift_x: Forward offset of the free body from the hip, S sin α₁ / m_x [m].
        shift_y: Upward offset, −S cos α₁ / m_y [m].
        foot_x: Forward distance of the foot from the hip [m].
        foot_y: Height of the foot above the hip, negative [m].
    """

    x: float
    yaw: float
    hip_rate: float
    shift_x: float
    shift_y: float
    foot_x: float
    foot_y: float


@as_written
def sense(settings, rates, sampled, inputs):
    """Returns `JointRates`, `JointMotion` and `Body` of this tick."""
    model = settings.sensor_model
    phi_1 = inputs.motor_1 * _TURN / model.motor_counts
    phi_2 = inputs.motor_2 * _TURN / model.motor_counts
    alpha_1 = 0.5 * (phi_1 + phi_2)
    alpha_2 = 0.5 * (phi_1 - phi_2)
    rates = with_reading(rates, sampled, alpha_1, alpha_2)
    yaw = yaw_of(model, inputs.boom_horizontal)
    pitch = inputs.boom_vertical * _TURN / model.boom_counts_vertical
    x = model.boom_length * yaw
    y = model.pivot_height + model.boom_length * np.sin(pitch)
    length, hip_rate, shift_x, shift_y, foot_x, foot_y = _leg_state(
        settings.masses, alpha_1, alpha_2, rates.rate_1, rates.rate_2
    )
    motion = JointMotion(
        alpha_1=alpha_1, alpha_2=alpha_2, rate_1=rates.rate_1, rate_2=rates.rate_2, leg_length=length, hip_height=y
    )
    body = Body(x=x, yaw=yaw, hip_rate=hip_rate, shift_x=shift_x, shift_y=shift_y, foot_x=foot_x, foot_y=foot_y)
    return rates, motion, body


@as_written
def yaw_of(model, counts):
    """Yaw of the boom [rad] for counts of its encoder."""
    return counts * _TURN / model.boom_counts_horizontal


@compiled
def _leg_state(masses, alpha_1, alpha_2, rate_1, rate_2):
    """Returns the leg length ℓ [m], and hip rate, shifts and foot as in `Body`."""
    bar = four_bar(masses.leg, alpha_2)
    toe = foot(masses.leg, bar, alpha_1)
    moment = leg_inertia(masses, bar, alpha_2).s
    return (
        bar.length,
        -(toe.y_1 * rate_1 + toe.y_2 * rate_2),
        moment * np.sin(alpha_1) / masses.x,
        -moment * np.cos(alpha_1) / masses.y,
        toe.x,
        toe.y,
    )


@as_written
def update_flight(model, state, sampled, motion, body, inputs):
    """Returns `FlightState` with this tick's sample, and the phase of this tick."""
    start, x, fit, last_speed = state.flight
    airborne = state.phase == Phase.ASCENT or state.phase == Phase.DESCENT
    if airborne and not inputs.stale:
        fit = with_sample(fit, sampled - start, body.x - x + body.shift_x, motion.hip_height + body.shift_y)
    phase = next_phase(
        state.phase, apex_passed(fit), inputs.contact_force, model.touchdown_force, motion.leg_length,
        model.takeoff_length, body.hip_rate,
    )  # fmt: skip
    if phase == Phase.ASCENT and state.phase != Phase.ASCENT:
        start = sampled
        x = body.x
        fit = NO_SAMPLES
    return FlightState(start, x, fit, last_speed), phase
