"""The hopper's map with torques held from tick to tick, as by the control loop of a robot; `ApexMap` is continuous.

The controller samples the robot at the apex and then once per tick. An event between two ticks (touchdown, mid-stance,
take-off) changes the motion immediately, but the torques only at the next tick. So for up to one tick after touchdown
the leg is still servoed as in flight, and the command starts to act up to one tick after mid-stance.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.compiled import compiled, implements
from stepgap.base.ranges import require
from stepgap.hybrid.integrator import BROKEN, TIME_OUT, Tolerance, integrate, make_trace, rewind
from stepgap.hybrid.motion import rate, rate_and_guards, rate_jacobian
from stepgap.robots.ground import FLAT_GROUND, UnevenGround
from stepgap.robots.hopper.model.apex_map import as_points, on_all_cores
from stepgap.robots.hopper.model.dynamics import (
    flight_acceleration,
    impact,
    masses_of,
    stance_acceleration,
    terms,
)
from stepgap.robots.hopper.model.hop import (
    CONTACT,
    FALLING_OVER,
    FELL,
    FIRST_STEP,
    FLIGHT_LIMIT,
    FOOT_SCUFFED,
    FULL_STRETCH,
    INVALID,
    NO_APEX,
    NO_TAKE_OFF,
    OK,
    REVERSAL,
    SCUFF_DEPTH,
    STANCE_LIMIT,
    STANDSTILL,
    STRETCHING,
)
from stepgap.robots.hopper.model.joint_control import joint_law, landing_posture, saturate
from stepgap.robots.hopper.model.leg import foot, four_bar
from stepgap.robots.hopper.model.reduced import (
    Flight,
    Hip,
    Stance,
    body_guards,
    flight_motion,
    flight_of,
    hip_in_flight,
    hip_in_stance,
    stance_motion,
)
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.step import Array, Outcome, StepMap, StepSpace, difference_jacobian

TICKS = (1e-5, 2e-3)
"""Shortest and longest tick [s]; the servo of the default gains is unstable with longer ones."""
DIFFERENCE = 0.05
"""Step of the Jacobian's differences, in half ranges; far longer than the effect of one tick more or less in stance."""


class HeldFlight(NamedTuple):
    """A flight during which the motors give constant torques [N·m]."""

    flight: Flight
    torque_1: float
    torque_2: float


class HeldStance(NamedTuple):
    """A stance during which the motors give constant torques [N·m]; contact cannot end before mid-stance."""

    stance: Stance
    torque_1: float
    torque_2: float


@compiled
def _held_flight(system, state):
    """Returns the rate, the `FourBar` and the `Terms`."""
    masses = system.flight.masses
    bar = four_bar(masses.leg, state[1])
    m = terms(masses, bar, state[0], state[1], state[2], state[3])
    acceleration = flight_acceleration(m, system.torque_1, system.torque_2)
    return (state[2], state[3], acceleration[2], acceleration[3]), bar, m


@implements(rate, HeldFlight)
def _flight_rate(system, state):
    return _held_flight(system, state)[0]


@implements(rate_and_guards, HeldFlight)
def _flight_rate_and_guards(system, time, state):
    motion, bar, m = _held_flight(system, state)
    hip = hip_in_flight(system.flight, m, time, state)
    clearance = hip.height + foot(system.flight.masses.leg, bar, state[0]).y
    return motion, body_guards(system.flight, clearance + system.flight.depth, hip, state)


@implements(rate_jacobian, HeldFlight)
def _flight_rate_jacobian(system, state, here):
    return None


@compiled
def _held_stance(system, state):
    """Returns the rate, the `Hip` and the upward ground force [N]."""
    masses = system.stance.masses
    bar = four_bar(masses.leg, state[1])
    toe, m = foot(masses.leg, bar, state[0]), terms(masses, bar, state[0], state[1], state[2], state[3])
    motion = stance_acceleration(m, toe, state[2], state[3], system.torque_1, system.torque_2)
    return (state[2], state[3], motion[2], motion[3]), hip_in_stance(toe, state), motion[5]


@implements(rate, HeldStance)
def _stance_rate(system, state):
    return _held_stance(system, state)[0]


@implements(rate_and_guards, HeldStance)
def _stance_rate_and_guards(system, time, state):
    motion, hip, force = _held_stance(system, state)
    return motion, body_guards(system.stance, 1.0 if system.stance.side < 0.0 else force, hip, state)


@implements(rate_jacobian, HeldStance)
def _stance_rate_jacobian(system, state, here):
    return None


@compiled
def _failure(event, common):
    """Status for an event that ends a phase in failure."""
    return FELL if event == FALLING_OVER else FULL_STRETCH if event == STRETCHING else common


@compiled
def _integrate_flight(flight, state, pending, tick, tolerance, trace):
    """Integrates a flight, which may start within a tick, to touchdown or the next apex.

    Args:
        flight: `Flight`.
        state: Leg angles and rates at its start.
        pending: (time to the next tick [s], torques held until then [N·m]).
        tick: Time between ticks [s].
        tolerance: `Tolerance`.
        trace: `Trace`, overwritten.

    Returns:
        (event, time, state, pending): CONTACT, REVERSAL or another event that ended the flight.
    """
    time, (remaining, torque_1, torque_2), limit = 0.0, pending, flight.law.torque_limit
    while time < FLIGHT_LIMIT:
        if remaining <= 0.0:
            asked_1, asked_2 = flight_motion(flight, time, state)[3]
            remaining, torque_1, torque_2 = tick, saturate(asked_1, limit), saturate(asked_2, limit)
        rewind(trace)
        begin, held = time, HeldFlight(flight, torque_1, torque_2)
        time, state, event, _ = integrate(held, time, state, begin + remaining, tolerance, FIRST_STEP, trace)
        remaining = 0.0 if event == TIME_OUT else remaining - (time - begin)
        if event != TIME_OUT:
            return event, time, state, (remaining, torque_1, torque_2)
    return BROKEN, time, state, (remaining, torque_1, torque_2)


@compiled
def _integrate_stance(masses, law, state, pending, tick, tolerance, trace, force_x, force_y):
    """Integrates a stance from just after the impact to take-off; arguments as for `_integrate_flight`.

    Returns:
        (event, state, pending): CONTACT at take-off, or another event that ended the stance.
    """
    stance = Stance(masses=masses, law=law, side=-1.0, force_x=0.0, force_y=0.0, mode_1=0.0, mode_2=0.0)
    if stance_motion(stance, state)[1].speed_y >= 0.0:
        stance = Stance(masses=masses, law=law, side=1.0, force_x=force_x, force_y=force_y, mode_1=0.0, mode_2=0.0)
    time, (remaining, torque_1, torque_2), limit = 0.0, pending, law.torque_limit
    while time < STANCE_LIMIT:
        if remaining <= 0.0:
            asked_1, asked_2 = stance_motion(stance, state)[3]
            remaining, torque_1, torque_2 = tick, saturate(asked_1, limit), saturate(asked_2, limit)
        rewind(trace)
        begin, held = time, HeldStance(stance, torque_1, torque_2)
        time, state, event, _ = integrate(held, time, state, begin + remaining, tolerance, FIRST_STEP, trace)
        remaining = 0.0 if event == TIME_OUT else remaining - (time - begin)
        if event == REVERSAL and stance.side < 0.0:
            stance = Stance(masses=masses, law=law, side=1.0, force_x=force_x, force_y=force_y, mode_1=0.0, mode_2=0.0)
        elif event != TIME_OUT:
            return event, state, (remaining, torque_1, torque_2)
    return BROKEN, state, (remaining, torque_1, torque_2)


@compiled
def sampled_hop(masses, law, tick, tolerance, speed, height, force_x, force_y, trace):
    """Integrates one hop with torques held for `tick` [s]; the other arguments are as in `hop`.

    Returns:
        (status, next speed, next height): `StepStatus` as an integer; NaN if there is no next apex.
    """
    no_apex = np.nan, np.nan
    if not np.isfinite(speed + height + force_x + force_y):
        return INVALID, *no_apex
    alpha_1, alpha_2 = landing_posture(law, speed)
    state = (alpha_1, alpha_2, 0.0, 0.0)
    flight = flight_of(masses, law, -1.0, 0.0, Hip(height, speed, 0.0), state)
    if flight_motion(flight, 0.0, state)[2] <= 0.0:
        return FOOT_SCUFFED, *no_apex
    event, time, state, pending = _integrate_flight(flight, state, (0.0, 0.0, 0.0), tick, tolerance, trace)
    if event != CONTACT:
        return _failure(event, NO_APEX), *no_apex

    bar = four_bar(masses.leg, state[1])
    toe, m = foot(masses.leg, bar, state[0]), terms(masses, bar, state[0], state[1], state[2], state[3])
    hip = hip_in_flight(flight, m, time, state)
    _, _, rate_1, rate_2 = impact(m, toe, hip.speed_x, hip.speed_y, state[2], state[3])
    state = (state[0], state[1], rate_1, rate_2)
    event, state, pending = _integrate_stance(masses, law, state, pending, tick, tolerance, trace, force_x, force_y)
    stance = Stance(masses=masses, law=law, side=1.0, force_x=force_x, force_y=force_y, mode_1=0.0, mode_2=0.0)
    hip = stance_motion(stance, state)[1]
    if event != CONTACT or hip.speed_y <= STANDSTILL:
        return _failure(event, NO_TAKE_OFF), *no_apex

    flight = flight_of(masses, law, 1.0, SCUFF_DEPTH, hip, state)
    event, time, state, _ = _integrate_flight(flight, state, pending, tick, tolerance, trace)
    if event != REVERSAL:
        return _failure(event, FOOT_SCUFFED if event == CONTACT else NO_APEX), *no_apex
    hip = flight_motion(flight, time, state)[1]
    return OK, hip.speed_x, hip.height


@compiled
def _hop_all(masses, law, tick, tolerance, points, next_state, status):
    trace = make_trace()
    for i in range(points.shape[0]):
        speed, height, force_x, force_y = points[i]
        status[i], next_state[i, 0], next_state[i, 1] = sampled_hop(
            masses, law, tick, tolerance, speed, height, force_x, force_y, trace
        )


@dataclass(frozen=True)
class SampledApexMap(StepMap):
    """Apex map with torques that change only once per tick, first at the apex; otherwise as `ApexMap`.

    Touchdown and mid-stance fall somewhere within a tick, so the map has small jumps where they pass from one tick
    to the next.

    Attributes:
        robot: The robot.
        gains: Its joint controller.
        bounds: Range of the command.
        tick: Time for which torques are held [s].
        tolerance: Local error of the integration within a tick.
        ground: As of `ApexMap`.

    Raises:
        ValueError: A length is out of the leg's reach, or the tick is out of its range.
    """

    robot: RobotParameters = field(default_factory=RobotParameters)
    gains: Gains = field(default_factory=Gains)
    bounds: CommandBounds = field(default_factory=CommandBounds)
    tick: float = 1e-3
    tolerance: Tolerance = Tolerance(1e-7, 1e-8)
    ground: UnevenGround = FLAT_GROUND

    def __post_init__(self) -> None:
        joint_law(self.robot, self.gains)
        require(TICKS[0] <= self.tick <= TICKS[1], "tick", self.tick, f"lie between {TICKS[0]:g} and {TICKS[1]:g} s")

    @property
    def space(self) -> StepSpace:
        """State [speed, height], command [fx, fy]."""
        return self.bounds.space(self.ground)

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next apexes and status codes; state (…, 2) and command (…, 2) broadcast.

        Raises:
            ValueError: The last axis of state or command does not have length 2.
        """
        points, leading = as_points(state, command)
        next_state, status = np.full((len(points), 2), np.nan), np.zeros(len(points), dtype=np.int64)
        constants = masses_of(self.robot), joint_law(self.robot, self.gains), self.tick, self.tolerance
        on_all_cores(_hop_all, constants, points, next_state, status)
        return Outcome(next_state.reshape(*leading, 2), status.reshape(leading))

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next speed, next height)/∂(speed, height, fx, fy) by differences that average over jumps; (…, 2, 4)."""
        return difference_jacobian(self, state, command, DIFFERENCE)
