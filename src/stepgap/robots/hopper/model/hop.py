"""One hop of the model: apex → touchdown → mid-stance → take-off → next apex (Fig. 2).

A hop is a sequence of smooth pieces, each ended by an event; `hybrid.integrator` integrates the reduced motion of a
piece. The hop is split at mid-stance, where the command starts to act: `to_midstance` does not depend on the command,
`to_apex` does.
"""

from typing import Any, NamedTuple

import numpy as np

from stepgap.base.compiled import compiled, implements
from stepgap.hybrid.integrator import BROKEN, Tolerance, integrate, retrace, rewind
from stepgap.hybrid.motion import rate, rate_and_guards, rate_jacobian
from stepgap.hybrid.rosenbrock import difference_rate_jacobian
from stepgap.robots.hopper.model.dynamics import impact, terms
from stepgap.robots.hopper.model.joint_control import landing_posture
from stepgap.robots.hopper.model.leg import foot, four_bar
from stepgap.robots.hopper.model.reduced import (
    Flight,
    Hip,
    Stance,
    flight_motion,
    flight_of,
    hip_in_flight,
    piece_guards,
    stance_motion,
)
from stepgap.step import StepStatus

CONTACT, REVERSAL, FALLING_OVER, STRETCHING, MOTOR_1, MOTOR_2 = range(6)  # guards in the order of `piece_guards`

SCUFF_DEPTH = 1e-4  # depth to which the foot may dip below the ground just after take-off [m]
FLIGHT_LIMIT = 2.0  # longest duration of a flight [s]
STANCE_LIMIT = 1.0  # longest duration of a stance [s]
MOST_PIECES = 100  # largest number of pieces in a phase
STANDSTILL = 1e-9  # largest ẏ caused by rounding alone [m/s]
FIRST_STEP = 3e-3  # first integration step of a phase [s]

OK = int(StepStatus.OK)
FELL = int(StepStatus.FELL)
NO_TAKE_OFF = int(StepStatus.NO_TAKE_OFF)
FULL_STRETCH = int(StepStatus.FULL_STRETCH)
FOOT_SCUFFED = int(StepStatus.FOOT_SCUFFED)
NO_APEX = int(StepStatus.NO_APEX)
INVALID = int(StepStatus.INVALID)


class Tolerances(NamedTuple):
    """Local error per step in flight and in stance."""

    flight: Tolerance
    stance: Tolerance


@implements(rate, Flight)
def _flight_rate(system, state):
    return flight_motion(system, 0.0, state)[0]


@implements(rate_and_guards, Flight)
def _flight_rate_and_guards(system, time, state):
    motion, hip, clearance, torques = flight_motion(system, time, state)
    return motion, piece_guards(system, clearance + system.depth, hip, state, torques)


@implements(rate_jacobian, Flight)
def _flight_rate_jacobian(system, state, here):
    return difference_rate_jacobian(system, state, here)


@implements(rate, Stance)
def _stance_rate(system, state):
    return stance_motion(system, state)[0]


@implements(rate_and_guards, Stance)
def _stance_rate_and_guards(system, time, state):
    motion, hip, force, torques = stance_motion(system, state)
    return motion, piece_guards(system, force, hip, state, torques)


@implements(rate_jacobian, Stance)
def _stance_rate_jacobian(system, state, here):
    return None


def switched(system, time, state, motor) -> Any:
    """System after motor 1 or 2 has started or stopped saturating."""
    raise TypeError(f"{type(system).__name__} has no motors")


@compiled
def _next_mode(mode, torque):
    """New mode of a motor that switches while its law requests this torque."""
    return 0.0 if mode != 0.0 else np.sign(torque)


@implements(switched, Flight)
def _flight_switched(system, time, state, motor):
    s = system
    torques = flight_motion(system, time, state)[3]
    mode_1 = _next_mode(s.mode_1, torques[0]) if motor == 1 else s.mode_1
    mode_2 = _next_mode(s.mode_2, torques[1]) if motor == 2 else s.mode_2
    return Flight(
        masses=s.masses, law=s.law, side=s.side, depth=s.depth, momentum_x=s.momentum_x, momentum_y=s.momentum_y,
        moment_y=s.moment_y, mode_1=mode_1, mode_2=mode_2,
    )  # fmt: skip


@implements(switched, Stance)
def _stance_switched(system, time, state, motor):
    s = system
    torques = stance_motion(system, state)[3]
    mode_1 = _next_mode(s.mode_1, torques[0]) if motor == 1 else s.mode_1
    mode_2 = _next_mode(s.mode_2, torques[1]) if motor == 2 else s.mode_2
    return Stance(
        masses=s.masses, law=s.law, side=s.side, force_x=s.force_x, force_y=s.force_y, mode_1=mode_1, mode_2=mode_2
    )


@compiled
def _run_phase(system, state, time_limit, tolerance, trace, retracing):
    """Integrates a phase, through saturation switches, until the contact or the sign of ẏ changes.

    Args:
        system: `Flight` or `Stance` with both motors obeying their laws.
        state: Leg angles and rates at the start.
        time_limit: Longest duration [s].
        tolerance: `Tolerance`.
        trace: `Trace`.
        retracing: Whether to retrace the steps of a neighbouring motion; then nothing can fail.

    Returns:
        (status, event, time, state): OK and CONTACT or REVERSAL, or a status that is common to both phases.
    """
    guards = rate_and_guards(system, 0.0, state)[1]
    time = 0.0
    event = BROKEN
    h = FIRST_STEP
    if guards[MOTOR_1] <= 0.0:
        system = switched(system, time, state, 1)
    if guards[MOTOR_2] <= 0.0:
        system = switched(system, time, state, 2)
    guards = rate_and_guards(system, 0.0, state)[1]
    if not retracing:
        if guards[FALLING_OVER] <= 0.0:
            return FELL, event, time, state
        if guards[STRETCHING] <= 0.0:
            return FULL_STRETCH, event, time, state
        if guards[CONTACT] <= 0.0:  # the ground cannot pull: a stance that starts without load ends immediately
            return OK, CONTACT, time, state
    # A motor begins and stops saturating where its law gives just the limit, so torques and rates have no jump there:
    # the next piece goes on from the same state with the same step size. All other events end the phase.
    for _ in range(MOST_PIECES):
        if retracing:
            time, state, event = retrace(system, time, state, trace)
        else:
            time, state, event, h = integrate(system, time, state, time_limit, tolerance, h, trace)
        if event != MOTOR_1 and event != MOTOR_2:
            break
        system = switched(system, time, state, 1 if event == MOTOR_1 else 2)
    if event == CONTACT or event == REVERSAL:
        return OK, event, time, state
    if event == FALLING_OVER:
        return FELL, event, time, state
    if event == STRETCHING:
        return FULL_STRETCH, event, time, state
    return NO_APEX, event, time, state


@compiled
def to_midstance(masses, law, tolerances, speed, height, trace, retracing):
    """Integrates from the apex through the impact to mid-stance, where ẏ = 0.

    Args:
        masses: `Masses`.
        law: `JointLaw`.
        tolerances: `Tolerances`.
        speed: Forward speed at the apex ẋ [m/s]; the leg is at rest in its landing posture.
        height: Hip height at the apex y [m].
        trace: `Trace` for the steps.
        retracing: Whether to retrace the steps stored in it.

    Returns:
        (status, state): `StepStatus` as an integer, and leg angles and rates at mid-stance.
    """
    rewind(trace)
    alpha_1, alpha_2 = landing_posture(law, speed)
    state = (alpha_1, alpha_2, 0.0, 0.0)
    if not np.isfinite(speed + height):
        return INVALID, state
    descent = flight_of(masses, law, -1.0, 0.0, Hip(height, speed, 0.0), state)
    if not retracing and rate_and_guards(descent, 0.0, state)[1][CONTACT] <= 0.0:
        return FOOT_SCUFFED, state
    status, event, time, state = _run_phase(descent, state, FLIGHT_LIMIT, tolerances.flight, trace, retracing)
    if status != OK or event != CONTACT:
        return status if status != OK else NO_APEX, state

    bar = four_bar(masses.leg, state[1])
    toe = foot(masses.leg, bar, state[0])
    m = terms(masses, bar, state[0], state[1], state[2], state[3])
    hip = hip_in_flight(descent, m, time, state)
    _, speed_y, rate_1, rate_2 = impact(m, toe, hip.speed_x, hip.speed_y, state[2], state[3])
    state = (state[0], state[1], rate_1, rate_2)
    if speed_y >= 0.0:
        return OK, state
    compression = Stance(masses=masses, law=law, side=-1.0, force_x=0.0, force_y=0.0, mode_1=0.0, mode_2=0.0)
    status, event, _, state = _run_phase(compression, state, STANCE_LIMIT, tolerances.stance, trace, retracing)
    if status == NO_APEX or event == CONTACT:
        status = NO_TAKE_OFF
    return status, state


@compiled
def to_apex(masses, law, tolerances, state, force_x, force_y, trace, retracing):
    """Integrates from mid-stance, where the command starts to act, through take-off to the next apex.

    Args:
        masses: `Masses`.
        law: `JointLaw`.
        tolerances: `Tolerances`.
        state: Leg angles and rates at mid-stance.
        force_x: Forward command force [N].
        force_y: Upward command force [N].
        trace: `Trace` for the steps.
        retracing: Whether to retrace the steps stored in it.

    Returns:
        (status, next speed, next height): `StepStatus` as an integer; NaN if there is no next apex.
    """
    rewind(trace)
    thrust = Stance(masses=masses, law=law, side=1.0, force_x=force_x, force_y=force_y, mode_1=0.0, mode_2=0.0)
    if not np.isfinite(force_x + force_y):
        return INVALID, np.nan, np.nan
    status, event, _, state = _run_phase(thrust, state, STANCE_LIMIT, tolerances.stance, trace, retracing)
    hip = stance_motion(thrust, state)[1]
    if status == NO_APEX or (status == OK and (event == REVERSAL or hip.speed_y <= STANDSTILL)):
        status = NO_TAKE_OFF
    if status != OK:
        return status, np.nan, np.nan

    ascent = flight_of(masses, law, 1.0, SCUFF_DEPTH, hip, state)
    status, event, time, state = _run_phase(ascent, state, FLIGHT_LIMIT, tolerances.flight, trace, retracing)
    if status != OK or event == CONTACT:
        return FOOT_SCUFFED if status == OK else status, np.nan, np.nan
    _, hip, _, _ = flight_motion(ascent, time, state)
    return OK, hip.speed_x, hip.height
