"""What a hop asks of motors and floor: the largest torque, and the friction without which the foot slips."""

import numpy as np

from stepgap.base.compiled import compiled
from stepgap.hybrid.motion import rate
from stepgap.robots.hopper.model.dynamics import impact, stance_acceleration, terms
from stepgap.robots.hopper.model.hop import FLIGHT_LIMIT, STANCE_LIMIT
from stepgap.robots.hopper.model.joint_control import commanded, landing_posture
from stepgap.robots.hopper.model.leg import foot, four_bar
from stepgap.robots.hopper.model.reduced import Hip, Stance, flight_motion, flight_of, hip_in_flight, stance_motion

_TIME_STEP = 2e-4
"""Step of the integration [s]; peaks of a smooth motion are right to some 1e-4 of their height."""


@compiled
def hop_loads(masses, law, speed, height, command_1, command_2):
    """Largest torque that the law asks for in stance [N·m], and the largest |P_x|/P_y of a ground force.

    Only ground forces that carry the robot's weight count: just before take-off, little force moves the foot little.

    Args:
        masses: `Masses`.
        law: `JointLaw`.
        speed: Speed at the apex [m/s].
        height: Height at the apex [m].
        command_1: First coordinate of the command.
        command_2: Second one.

    Returns:
        Both; NaN if the hop has no take-off.
    """
    laws = commanded(law, command_1, command_2)
    alpha_1, alpha_2 = landing_posture(laws.landing, speed)
    state, time = (alpha_1, alpha_2, 0.0, 0.0), 0.0
    flight = flight_of(masses, laws.landing, -1.0, 0.0, Hip(height, speed, 0.0), state)
    while flight_motion(flight, time, state)[2] > 0.0 and time < FLIGHT_LIMIT:
        state, time = _runge_kutta(flight, state), time + _TIME_STEP
    bar = four_bar(masses.leg, state[1])
    toe, m = foot(masses.leg, bar, state[0]), terms(masses, bar, state[0], state[1], state[2], state[3])
    hip = hip_in_flight(flight, m, time, state)
    _, _, rate_1, rate_2 = impact(m, toe, hip.speed_x, hip.speed_y, state[2], state[3])
    state, torque, friction, thrusts = (state[0], state[1], rate_1, rate_2), 0.0, 0.0, False
    for _ in range(int(STANCE_LIMIT / _TIME_STEP)):
        stance = Stance(
            masses=masses, law=laws.thrust if thrusts else laws.landing, side=1.0,
            force_x=laws.force_x if thrusts else 0.0, force_y=laws.force_y if thrusts else 0.0, mode_1=0.0, mode_2=0.0,
        )  # fmt: skip
        _, hip, _, torques = stance_motion(stance, state)
        force_x, force_y = _ground_force(masses, state, torques)
        if thrusts and force_y <= 0.0:
            return torque, friction
        thrusts = thrusts or hip.speed_y >= 0.0
        torque = max(torque, abs(torques[0]), abs(torques[1]))
        if force_y > masses.weight:
            friction = max(friction, abs(force_x) / force_y)
        state = _runge_kutta(stance, state)
    return np.nan, np.nan


@compiled
def _ground_force(masses, state, torques):
    bar = four_bar(masses.leg, state[1])
    toe, m = foot(masses.leg, bar, state[0]), terms(masses, bar, state[0], state[1], state[2], state[3])
    return stance_acceleration(m, toe, state[2], state[3], torques[0], torques[1])[4:]


@compiled
def _moved(state, motion, time):
    """State after a time [s] at a constant rate."""
    return (
        state[0] + time * motion[0],
        state[1] + time * motion[1],
        state[2] + time * motion[2],
        state[3] + time * motion[3],
    )


@compiled
def _runge_kutta(system, state):
    """State after a time step by the classical Runge–Kutta method."""
    first = rate(system, state)
    second = rate(system, _moved(state, first, 0.5 * _TIME_STEP))
    third = rate(system, _moved(state, second, 0.5 * _TIME_STEP))
    fourth = rate(system, _moved(state, third, _TIME_STEP))
    for motion, share in ((first, 1.0), (second, 2.0), (third, 2.0), (fourth, 1.0)):
        state = _moved(state, motion, share * _TIME_STEP / 6.0)
    return state
