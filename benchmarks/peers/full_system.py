"""A straightforward hop: the full systems of Eqs. 4, 5 and 8 in NumPy, integrated by SciPy's solve_ivp.

Every mass sits at hip + a u(α₁ ± α₂) + b u(α₁ ∓ β) with u(φ) = (sin φ, −cos φ), and so does the foot; masses and
bias follow from the Jacobians of these points. `make_rates` gives the right-hand sides, plain or compiled by Numba.
It is independent of `stepgap.robots.hopper`, except for the parameters. Torques are limited, but the points where the
limit becomes active are not events of solve_ivp. Failures of a hop are NaN.
"""

from collections.abc import Callable
from functools import cache
from math import acos, atan2, cos, sin, sqrt
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from stepgap.robots.hopper.parameters import Gains, RobotParameters

Plain = Callable[[Callable[..., Any]], Callable[..., Any]]


def constants(robot: RobotParameters, gains: Gains) -> tuple[float, ...]:
    """Constants that the right-hand sides unpack."""
    l1, l2, landing = robot.top_length, robot.bottom_length, gains.landing_length
    return (
        l1, l2, robot.foot_length, robot.top_com, robot.bottom_com, robot.top_mass, robot.bottom_mass,
        robot.top_inertia, robot.bottom_inertia, robot.body_mass,
        robot.boom_inertia_horizontal / robot.boom_length**2, robot.boom_inertia_vertical / robot.boom_length**2,
        robot.gravity, robot.torque_limit, gains.stiffness, gains.rest_length,
        acos((l1**2 + landing**2 - l2**2) / (2 * l1 * landing)),
        gains.speed_gain, gains.speed_setpoint, gains.position_gain, gains.damping_gain,
    )  # fmt: skip


def plain(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator that leaves a function to the interpreter."""
    return function


@cache
def make_rates(compiled: Plain) -> tuple[Callable[..., Any], ...]:
    """Functions (flight_rate, stance, impact, foot_height) of state (x, y, α₁, α₂ and rates) and constants."""

    @compiled
    def point(q, qd, l1, l2, side, a, b):
        """Jacobian (2, 4) of hip + a u(α₁ + side α₂) + b u(α₁ − side β), bias J̇q̇ (2,), height over the hip."""
        phi = q[2] + side * q[3]
        sin_beta = l1 / l2 * sin(q[3])
        cos_beta = sqrt(1 - sin_beta**2)
        d_beta = l1 / l2 * cos(q[3]) / cos_beta
        dd_beta = (sin_beta * d_beta**2 - sin_beta) / cos_beta
        theta = q[2] - side * atan2(sin_beta, cos_beta)
        n_phi, n_theta = np.array([cos(phi), sin(phi)]), np.array([cos(theta), sin(theta)])
        u_phi, u_theta = np.array([n_phi[1], -n_phi[0]]), np.array([n_theta[1], -n_theta[0]])
        jacobian = np.zeros((2, 4))
        jacobian[0, 0] = jacobian[1, 1] = 1.0
        jacobian[:, 2] = a * n_phi + b * n_theta
        jacobian[:, 3] = side * (a * n_phi - d_beta * b * n_theta)
        turn, d_turn = qd[2] - side * d_beta * qd[3], -side * dd_beta * qd[3] ** 2
        bias = -a * (qd[2] + side * qd[3]) ** 2 * u_phi - b * turn**2 * u_theta + b * d_turn * n_theta
        return jacobian, bias, a * u_phi[1] + b * u_theta[1], d_beta, d_turn

    @compiled
    def masses(q, qd, p):
        """M (4, 4) and N (4,) of Eq. 2."""
        l1, l2, _, c1, c2, m1, m2, i1, i2, body, boom_x, boom_y, g = p[:13]
        mass, bias = np.zeros((4, 4)), np.zeros(4)
        mass[0, 0], mass[1, 1], bias[1] = body + boom_x, body + boom_y, body * g
        lift = np.array([0.0, g])
        for side in (1.0, -1.0):
            jacobian, drift, _, _, _ = point(q, qd, l1, l2, side, c1, 0.0)
            turn = np.array([0.0, 0.0, 1.0, side])
            mass += m1 * jacobian.T @ jacobian + i1 * np.outer(turn, turn)
            bias += m1 * jacobian.T @ (drift + lift)
            jacobian, drift, _, d_beta, d_turn = point(q, qd, l1, l2, side, l1, c2)
            turn = np.array([0.0, 0.0, 1.0, -side * d_beta])
            mass += m2 * jacobian.T @ jacobian + i2 * np.outer(turn, turn)
            bias += m2 * jacobian.T @ (drift + lift) + i2 * d_turn * turn
        return mass, bias

    @compiled
    def limited(torque_1, torque_2, limit):
        """Generalised force (4,) after each motor's limit."""
        one = min(limit, max(-limit, (torque_1 + torque_2) / 2))
        two = min(limit, max(-limit, (torque_1 - torque_2) / 2))
        return np.array([0.0, 0.0, one + two, one - two])

    @compiled
    def flight_rate(state, p):
        """Rate (8,) in flight by Eq. 5."""
        limit, landing, speed_gain, setpoint, position_gain, damping_gain = p[13], p[16], p[17], p[18], p[19], p[20]
        mass, bias = masses(state[:4], state[4:], p)
        force = limited(
            -position_gain * (state[2] - speed_gain * (state[4] - setpoint)) - damping_gain * state[6],
            -position_gain * (state[3] - landing) - damping_gain * state[7],
            limit,
        )
        return np.concatenate((state[4:], np.linalg.solve(mass, force - bias)))

    @compiled
    def constrained(mass, jacobian, upper, lower):
        """Solves [[M, −Jᵀ], [J, 0]] z = (upper, lower)."""
        left, right = np.zeros((6, 6)), np.zeros(6)
        left[:4, :4], left[:4, 4:], left[4:, :4] = mass, -jacobian.T, jacobian
        right[:4], right[4:] = upper, lower
        return np.linalg.solve(left, right)

    @compiled
    def stance(state, force_x, force_y, p):
        """Rate (8,) and upward ground force by Eq. 4."""
        l1, l2, l3, limit, stiffness, rest = p[0], p[1], p[2], p[13], p[14], p[15]
        q, qd = state[:4], state[4:]
        mass, bias = masses(q, qd, p)
        jacobian, drift, _, _, _ = point(q, qd, l1, l2, -1.0, l1, l2 + l3)
        length = l1 * cos(q[3]) + sqrt(l2**2 - (l1 * sin(q[3])) ** 2)
        spring = -stiffness * (length - rest)
        body = np.array([-spring * sin(q[2]) + force_x, spring * cos(q[2]) + force_y])
        torque = -(jacobian.T @ body)
        z = constrained(mass, jacobian, limited(torque[2], torque[3], limit) - bias, -drift)
        return np.concatenate((qd, z[:4])), z[5]

    @compiled
    def impact(state, p):
        """State after the impact (Eq. 8)."""
        q, qd = state[:4], state[4:]
        mass, _ = masses(q, qd, p)
        jacobian, _, _, _, _ = point(q, qd, p[0], p[1], -1.0, p[0], p[1] + p[2])
        return np.concatenate((q, constrained(mass, jacobian, mass @ qd, np.zeros(2))[:4]))

    @compiled
    def foot_height(state, p):
        """Height of the foot above the ground."""
        return state[1] + point(state[:4], state[4:], p[0], p[1], -1.0, p[0], p[1] + p[2])[2]

    return flight_rate, stance, impact, foot_height


def make_hop(
    robot: RobotParameters, gains: Gains, compiled: Plain, rtol: float, atol: float, max_step: float = np.inf
) -> Callable[[Any, Any], Any]:
    """Makes a function (state, command) → next state by DOP853, shape (2,) each."""
    flight_rate, stance, impact, foot_height = make_rates(compiled)
    p = constants(robot, gains)
    tolerances: dict[str, Any] = {"method": "DOP853", "rtol": rtol, "atol": atol, "max_step": max_step}

    def until(rate: Callable[..., Any], event: Callable[..., Any], direction: float, state: Any) -> Any:
        setattr(event, "terminal", True)  # noqa: B010  (functions have no such attribute for the type checker)
        setattr(event, "direction", direction)  # noqa: B010
        if not np.isfinite(state).all():
            return state
        found = solve_ivp(rate, (0.0, 2.0), state, events=event, **tolerances)
        return found.y[:, -1] if found.status == 1 else np.full(8, np.nan)

    def hop(start: Any, command: Any) -> Any:
        fx, fy = float(command[0]), float(command[1])
        state = np.array([0.0, start[1], p[17] * (start[0] - p[18]), p[16], start[0], 0.0, 0.0, 0.0])
        state = until(lambda t, s: flight_rate(s, p), lambda t, s: foot_height(s, p), -1.0, state)
        state = impact(state, p)
        if state[5] < 0:
            state = until(lambda t, s: stance(s, 0.0, 0.0, p)[0], lambda t, s: s[5], 1.0, state)
        state = until(lambda t, s: stance(s, fx, fy, p)[0], lambda t, s: stance(s, fx, fy, p)[1], -1.0, state)
        state = until(lambda t, s: flight_rate(s, p), lambda t, s: s[5], -1.0, state)
        return np.array([state[4], state[1]])

    return hop
