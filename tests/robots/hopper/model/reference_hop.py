"""Independent computation of one hop: the paper's full systems, SciPy's DOP853 and a separate search for events.

Equations 4, 5 and 8 are assembled from the SymPy oracle and solved in that form; the torque laws are
written from Sec. 4.1 and the table of notation. Only numbers are shared with `stepgap.robots.hopper`: those of the
robot and of the gains, and the limits in `hop` and `reduced` that define a failure.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853
from scipy.optimize import brentq

from stepgap.robots.hopper import Gains, RobotParameters
from stepgap.robots.hopper.model.hop import FLIGHT_LIMIT, SCUFF_DEPTH, STANCE_LIMIT
from stepgap.robots.hopper.model.reduced import FOLD_ANGLE, LEAN_ANGLE, STRETCH_ANGLE
from stepgap.step import StepStatus
from tests.robots.hopper.model.lagrangian import oracle

MOTORS = np.array([[1.0, 1.0], [1.0, -1.0]])  # generalised torques on (α₁, α₂) of the two motors
SAMPLES = np.array([0.2, 0.4, 0.6, 0.8, 1.0])  # fractions of a step at which the guards are evaluated
MOST_STEPS = 20_000

Array = NDArray[Any]
State = Array  # (x, y, α₁, α₂, ẋ, ẏ, α̇₁, α̇₂)


def leg_length(robot: RobotParameters, alpha_2: float) -> float:
    """Leg length ℓ from the triangle hip, knee, joint [m]."""
    offset, drop = robot.top_length * np.sin(alpha_2), robot.top_length * np.cos(alpha_2)
    return drop + np.sqrt(robot.bottom_length**2 - offset**2)


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """Zero of a function between two arguments where its signs differ."""
    return cast(float, brentq(function, low, high, xtol=1e-15))


@cache
def knee(robot: RobotParameters, length: float) -> float:
    """α₂ at a leg length, by root finding [rad]."""
    return root(lambda alpha_2: leg_length(robot, alpha_2) - length, 0.0, np.pi)


class Hopper:
    """The robot under its joint control, by the full systems of the paper."""

    def __init__(self, robot: RobotParameters, gains: Gains) -> None:
        self.robot, self.gains = robot, gains
        mechanism = oracle(replace(robot, torque_limit=1.0))  # one derivation for all torque limits
        self.mass, self.bias, self.jacobian, self.drift, self.energy, self.foot = mechanism

    def flight_force(self, state: State) -> Array:
        """Generalised force of the motors in flight; shape (4,)."""
        gains = self.gains
        desired = gains.speed_gain * (state[4] - gains.speed_setpoint), knee(self.robot, gains.landing_length)
        return self.limited(-gains.position_gain * (state[2:4] - desired) - gains.damping_gain * state[6:8])

    def stance_force(self, state: State, jacobian: Array, command: Array) -> Array:
        """Generalised force of the motors in stance; shape (4,)."""
        spring = -self.gains.stiffness * (leg_length(self.robot, state[3]) - self.gains.rest_length)
        body = spring * np.array([-np.sin(state[2]), np.cos(state[2])]) + command
        return self.limited(-jacobian[:, 2:].T @ body)

    def limited(self, torque: Array) -> Array:
        """Generalised force after each motor's limit; shape (4,)."""
        limit = self.robot.torque_limit
        return np.concatenate([[0.0, 0.0], MOTORS @ np.clip(np.linalg.solve(MOTORS, torque), -limit, limit)])

    def flight_rate(self, state: State) -> State:
        """Rate in flight by Eq. 5."""
        q, qd = state[:4], state[4:]
        return np.concatenate([qd, np.linalg.solve(self.mass(q, qd), self.flight_force(state) - self.bias(q, qd))])

    def stance(self, state: State, command: Array) -> tuple[Array, Array]:
        """Accelerations and ground force by Eq. 4."""
        q, qd = state[:4], state[4:]
        jacobian = self.jacobian(q, qd)
        left = np.block([[self.mass(q, qd), -jacobian.T], [jacobian, np.zeros((2, 2))]])
        right = np.concatenate([self.stance_force(state, jacobian, command) - self.bias(q, qd), -self.drift(q, qd)])
        solution = np.linalg.solve(left, right)
        return solution[:4], solution[4:]

    def impact(self, state: State) -> tuple[State, Array]:
        """State after the impact and the impulse (Eq. 8)."""
        q, qd = state[:4], state[4:]
        mass, jacobian = self.mass(q, qd), self.jacobian(q, qd)
        left = np.block([[mass, -jacobian.T], [jacobian, np.zeros((2, 2))]])
        solution = np.linalg.solve(left, np.concatenate([mass @ qd, [0.0, 0.0]]))
        return np.concatenate([q, solution[:4]]), solution[4:]

    def failures(self, state: State) -> list[float]:
        """Guards that are positive while the robot is upright, and while the leg is bent."""
        upright = min(state[1] - self.robot.top_length, LEAN_ANGLE - abs(state[2]), FOLD_ANGLE - state[3])
        return [upright, state[3] - STRETCH_ANGLE]


def integrate(
    rate: Callable[[State], State], guards: Callable[[State], list[float]], state: State, limit: float
) -> tuple[State, int | None]:
    """Integrates until a guard is no longer positive; returns the state and the index of the guard, or None."""
    solver = DOP853(lambda _, state: rate(state), 0.0, state, limit, rtol=1e-12, atol=1e-13)
    before, last = np.array(guards(state)), 0.0
    if (before < 0).any():
        return state, int(np.argmax(before < 0))
    for _ in range(MOST_STEPS):
        solver.step()
        if solver.status == "failed" or not np.isfinite(solver.y).all():
            break
        inside = solver.dense_output()
        for time in solver.t_old + SAMPLES * (solver.t - solver.t_old):
            after = np.array(guards(inside(time)))
            crossed = np.flatnonzero(after <= 0)
            if crossed.size:
                times = [
                    root(lambda t, j=j, inside=inside: guards(inside(t))[j], last, time) if before[j] > 0 else last
                    for j in crossed
                ]
                first = times.index(min(times))
                return inside(times[first]), int(crossed[first])
            before, last = after, time
        if solver.status == "finished":
            break
    return solver.y, None


def reference_hop(hopper: Hopper, start: Array, command: Array) -> tuple[StepStatus, Array]:
    """Status and next apex [speed, height] of one hop; NaN if there is none."""
    none, gains = np.full(2, np.nan), hopper.gains
    posture = gains.speed_gain * (start[0] - gains.speed_setpoint), knee(hopper.robot, gains.landing_length)
    state = np.array([0.0, start[1], *posture, start[0], 0.0, 0.0, 0.0])

    def clearance(state: State) -> float:
        return hopper.foot(state[:4], state[4:])[1]

    def falling(state: State) -> list[float]:
        return [*hopper.failures(state), clearance(state), -state[5]]

    def rising(state: State) -> list[float]:
        return [*hopper.failures(state), clearance(state) + SCUFF_DEPTH, state[5]]

    failures = [StepStatus.FELL, StepStatus.FULL_STRETCH]
    if clearance(state) <= 0:
        return StepStatus.FOOT_SCUFFED, none
    state, event = integrate(hopper.flight_rate, falling, state, FLIGHT_LIMIT)
    if event != 2:
        return [*failures, StepStatus.OK, StepStatus.NO_APEX][3 if event is None else event], none

    state, _ = hopper.impact(state)
    for push, sign in ((np.zeros(2), -1.0), (np.asarray(command, float), 1.0)):
        if sign * state[5] < 0:
            continue  # the impact itself has reversed the vertical speed

        def standing(state: State, push: Array = push, sign: float = sign) -> list[float]:
            return [*hopper.failures(state), hopper.stance(state, push)[1][1], sign * state[5]]

        def flow(state: State, push: Array = push) -> State:
            return np.concatenate([state[4:], hopper.stance(state, push)[0]])

        state, event = integrate(flow, standing, state, STANCE_LIMIT)
        if event in (0, 1):
            return failures[event], none
        if event is None or event != (3 if sign < 0 else 2):
            return StepStatus.NO_TAKE_OFF, none
        if sign < 0:
            state[5] = 0.0
    if state[5] <= 0:
        return StepStatus.NO_TAKE_OFF, none

    state, event = integrate(hopper.flight_rate, rising, state, FLIGHT_LIMIT)
    if event != 3:
        return [*failures, StepStatus.FOOT_SCUFFED, StepStatus.NO_APEX][3 if event is None else event], none
    return StepStatus.OK, np.array([state[4], state[1]])
