"""One hop of the model: apex → touchdown → mid-stance → take-off → next apex (Fig. 2).

The chain of smooth pieces and what ends each of them; `hybrid.integrator` moves along a piece. The
integrator's state is (x, y, α₁, α₂, ẋ, ẏ, α̇₁, α̇₂).
"""

from typing import NamedTuple

import numpy as np

from stepgap.hopper.dynamics import Masses, flight_acceleration, impact, stance_acceleration, terms
from stepgap.hopper.joint_control import JointLaw, flight_torque, landing_posture, saturate, stance_torque
from stepgap.hopper.leg import foot, four_bar
from stepgap.hybrid.compiled import compiled, implements
from stepgap.hybrid.integrator import (
    BROKEN,
    TIME_OUT,
    Tolerance,
    guards,
    integrate,
    make_workspace,
    rate,
    take_sides,
)
from stepgap.step import Reason

STATES, GUARDS = 8, 6
CONTACT, RISING, FALLING_OVER, STRETCHING = 0, 1, 2, 3  # guards 4 and 5: saturation of either motor

STRETCH_ANGLE = 0.02  # α₂ at which the leg counts as fully stretched [rad]
LEAN_ANGLE = 1.0  # |α₁| at which the robot counts as fallen [rad]
FOLD_ANGLE = 2.5  # α₂ at which the leg has collapsed [rad]
SCUFF_DEPTH = 1e-4  # how far the foot may dip below the ground as it leaves it [m]
FLIGHT_LIMIT, STANCE_LIMIT = 2.0, 1.0  # longest phases [s]

OK = int(Reason.OK)
FELL = int(Reason.FELL)
NO_TAKE_OFF = int(Reason.NO_TAKE_OFF)
FULL_STRETCH = int(Reason.FULL_STRETCH)
FOOT_SCUFFED = int(Reason.FOOT_SCUFFED)
NO_APEX = int(Reason.NO_APEX)
INVALID = int(Reason.INVALID)


class Tolerances(NamedTuple):
    """Local error per step in flight and in stance.

    In flight the step size is held by the stability of the servoed leg, not by accuracy.
    """

    flight: Tolerance
    stance: Tolerance


class Flight(NamedTuple):
    """Constants of a flight.

    Attributes:
        masses: Mass properties.
        law: Torque laws.
        depth: Depth below the ground at which the foot counts as touching it [m].
    """

    masses: Masses
    law: JointLaw
    depth: float


class Stance(NamedTuple):
    """Constants of one half of a stance.

    Attributes:
        masses: Mass properties.
        law: Torque laws.
        force_x: Forward command force [N]; zero before mid-stance.
        force_y: Upward command force [N]; zero before mid-stance.
    """

    masses: Masses
    law: JointLaw
    force_x: float
    force_y: float


@compiled
def uprightness(leg, height, alpha_1, alpha_2):
    """Positive until the robot has fallen: hip low enough for a knee to touch, leg far over, or leg collapsed.

    Hip height [m], leg angles [rad].
    """
    return min(height - leg.top, LEAN_ANGLE - abs(alpha_1), FOLD_ANGLE - alpha_2)


@implements(rate, Flight)
def _flight_rate(system, state, out):
    torque_1, torque_2 = flight_torque(system.law, state[2], state[3], state[6], state[7], state[4])
    bar = four_bar(system.masses.leg, state[3])
    m = terms(system.masses, bar, state[2], state[3], state[6], state[7])
    limit = system.law.torque_limit
    out[0], out[1], out[2], out[3] = state[4], state[5], state[6], state[7]
    out[4], out[5], out[6], out[7] = flight_acceleration(m, saturate(torque_1, limit), saturate(torque_2, limit))


@implements(guards, Flight)
def _flight_guards(system, state, out):
    torque_1, torque_2 = flight_torque(system.law, state[2], state[3], state[6], state[7], state[4])
    toe = foot(system.masses.leg, four_bar(system.masses.leg, state[3]), state[2])
    out[CONTACT] = state[1] + toe.y + system.depth
    _body_guards(system, state, torque_1, torque_2, out)


@compiled
def _stance(system, state):
    """Accelerations, ground force and unsaturated motor torques in stance."""
    bar = four_bar(system.masses.leg, state[3])
    toe = foot(system.masses.leg, bar, state[2])
    m = terms(system.masses, bar, state[2], state[3], state[6], state[7])
    torque_1, torque_2 = stance_torque(
        system.law, bar, toe, np.sin(state[2]), np.cos(state[2]), system.force_x, system.force_y
    )
    limit = system.law.torque_limit
    motion = stance_acceleration(m, toe, state[6], state[7], saturate(torque_1, limit), saturate(torque_2, limit))
    return motion, torque_1, torque_2


@implements(rate, Stance)
def _stance_rate(system, state, out):
    motion, _, _ = _stance(system, state)
    out[0], out[1], out[2], out[3] = state[4], state[5], state[6], state[7]
    out[4], out[5], out[6], out[7] = motion[0], motion[1], motion[2], motion[3]


@implements(guards, Stance)
def _stance_guards(system, state, out):
    motion, torque_1, torque_2 = _stance(system, state)
    out[CONTACT] = motion[5]
    _body_guards(system, state, torque_1, torque_2, out)


@compiled
def _body_guards(system, state, torque_1, torque_2, out):
    limit = system.law.torque_limit
    out[RISING] = state[5]
    out[FALLING_OVER] = uprightness(system.masses.leg, state[1], state[2], state[3])
    out[STRETCHING] = state[3] - STRETCH_ANGLE
    out[4] = 1.0 - (torque_1 / limit) ** 2
    out[5] = 1.0 - (torque_2 / limit) ** 2


@compiled
def _run_phase(system, state, time_limit, tolerance, work, side):
    """Goes on through saturation switches until the contact changes or ẏ changes sign.

    Args other than the integrator's:
        side: Sign of ẏ during the phase, ±1; at its start ẏ may be zero.

    Returns:
        CONTACT or RISING, or −1 − reason for a failure common to both phases.
    """
    take_sides(system, state, work)
    work.signs[RISING] = side
    if work.signs[FALLING_OVER] < 0:
        return -1 - FELL
    if work.signs[STRETCHING] < 0:
        return -1 - FULL_STRETCH
    if work.signs[CONTACT] < 0:  # the ground never pulls: a stance that begins without load ends at once
        return CONTACT
    left = time_limit
    for _ in range(100):
        elapsed, event = integrate(system, state, left, tolerance, work)
        left -= elapsed
        if event == CONTACT or event == RISING:
            return event
        if event == FALLING_OVER:
            return -1 - FELL
        if event == STRETCHING:
            return -1 - FULL_STRETCH
        if event == TIME_OUT or event == BROKEN:
            break
    return -1 - NO_APEX


@compiled
def hop(masses, law, tolerances, speed, height, force_x, force_y, out):
    """Runs one hop (Eq. 10) and writes (next speed, next height) into `out` if there is a next apex.

    Args:
        masses: `Masses`.
        law: `JointLaw`.
        tolerances: `Tolerances`.
        speed: Forward speed at the apex ẋ [m/s]; the leg is at rest in its landing posture.
        height: Hip height at the apex y [m].
        force_x: Forward command force [N].
        force_y: Upward command force [N].
        out: Shape (2,).

    Returns:
        `Reason` as an integer.
    """
    if not np.isfinite(speed + height + force_x + force_y):
        return INVALID
    state = np.zeros(STATES)
    state[1], state[4] = height, speed
    state[2], state[3] = landing_posture(law, speed)
    work = make_workspace(STATES, GUARDS)

    falling = Flight(masses, law, 0.0)
    guards(falling, state, work.guard)
    if work.guard[CONTACT] <= 0.0:
        return FOOT_SCUFFED
    event = _run_phase(falling, state, FLIGHT_LIMIT, tolerances.flight, work, -1.0)
    if event != CONTACT:
        return -1 - event if event < 0 else NO_APEX

    reason = _stand(masses, law, tolerances, state, force_x, force_y, work)
    if reason != OK:
        return reason

    rising = Flight(masses, law, SCUFF_DEPTH)
    event = _run_phase(rising, state, FLIGHT_LIMIT, tolerances.flight, work, 1.0)
    if event < 0:
        return -1 - event
    if event == CONTACT:
        return FOOT_SCUFFED
    out[0], out[1] = state[4], state[1]
    return OK


@compiled
def _stand(masses, law, tolerances, state, force_x, force_y, work):
    """From touchdown through the impact to take-off; the command acts after mid-stance."""
    bar = four_bar(masses.leg, state[3])
    m = terms(masses, bar, state[2], state[3], state[6], state[7])
    state[4], state[5], state[6], state[7] = impact(
        m, foot(masses.leg, bar, state[2]), state[4], state[5], state[6], state[7]
    )
    loading = Stance(masses, law, 0.0, 0.0)
    pushing = Stance(masses, law, force_x, force_y)
    if state[5] < 0.0:
        event = _run_phase(loading, state, STANCE_LIMIT, tolerances.stance, work, -1.0)
        if event < 0:
            return NO_TAKE_OFF if event == -1 - NO_APEX else -1 - event
        if event == CONTACT:
            return NO_TAKE_OFF
        state[5] = 0.0
    event = _run_phase(pushing, state, STANCE_LIMIT, tolerances.stance, work, 1.0)
    if event < 0:
        return NO_TAKE_OFF if event == -1 - NO_APEX else -1 - event
    if event == RISING or state[5] <= 0.0:
        return NO_TAKE_OFF
    return OK
