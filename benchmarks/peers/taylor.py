"""The hop by heyoka's Taylor integrator: the reduced systems as expressions, compiled just in time.

There are four unknown accelerations in flight and two in stance, as in `full_system`, with the leg's first moment S and
inertias A, D. Torques are not limited: with the default gains no motor reaches its limit within the ranges of state and
command.
"""

# pyright: reportMissingImports=false
# (heyoka is no dependency.)

from collections.abc import Callable
from typing import Any

import heyoka as hy
import numba
import numpy as np

from benchmarks.peers.full_system import constants, make_rates
from stepgap.robots.hopper.parameters import Gains, RobotParameters


def make_hop(robot: RobotParameters, gains: Gains, tolerance: float) -> Callable[[Any, Any], Any]:
    """Makes a function (state, command) → next state, shape (2,) each."""
    p = constants(robot, gains)
    l1, l2, l3, c1, c2, m1, m2, i1, i2, body, boom_x, boom_y, g = p[:13]
    _, stiffness, rest, landing, speed_gain, setpoint, position_gain, damping_gain = p[13:]
    y, a1, a2, vx, vy, w1, w2 = names = hy.make_vars("y", "a1", "a2", "vx", "vy", "w1", "w2")
    fx, fy = hy.par[0], hy.par[1]
    total = body + 2 * (m1 + m2)
    mx, my = total + boom_x, total + boom_y
    s1, k1, s2, k2 = hy.sin(a1), hy.cos(a1), hy.sin(a2), hy.cos(a2)
    sb = l1 / l2 * s2
    kb = hy.sqrt(1.0 - sb * sb)
    db = l1 / l2 * k2 / kb
    ddb = (sb * db * db - sb) / kb
    sk, kk = s2 * kb + k2 * sb, k2 * kb - s2 * sb
    knee, shank, couple = m1 * c1 + m2 * l1, m2 * c2, m2 * l1 * c2
    thigh, low = m1 * c1**2 + i1 + m2 * l1**2, m2 * c2**2 + i2
    s = 2.0 * (knee * k2 + shank * kb)
    ds = -2.0 * (knee * s2 + shank * sb * db)
    dds = -2.0 * (knee * k2 + shank * (kb * db * db + sb * ddb))
    a, d_a = 2.0 * (thigh + low + 2.0 * couple * kk), -4.0 * couple * sk * (1.0 + db)
    d = 2.0 * (thigh + low * db * db - 2.0 * couple * db * kk)
    d_d = 4.0 * (low * db * ddb - couple * (ddb * kk - db * sk * (1.0 + db)))
    along, across = dds * w2 * w2 - s * w1 * w1, 2.0 * ds * w1 * w2
    nx, ny = along * s1 + across * k1, across * s1 - along * k1 + total * g
    n1 = d_a * w1 * w2 + g * s * s1
    n2 = 0.5 * d_d * w2 * w2 - 0.5 * d_a * w1 * w1 - g * ds * k1
    x1, x2, y1, y2 = s * k1, ds * s1, s * s1, -1.0 * ds * k1

    def pair(p11: Any, p12: Any, p22: Any, r1: Any, r2: Any) -> tuple[Any, Any]:
        det = p11 * p22 - p12 * p12
        return (p22 * r1 - p12 * r2) / det, (p11 * r2 - p12 * r1) / det

    def rates(ax: Any, ay: Any, b1: Any, b2: Any) -> list[Any]:
        return list(zip(names, [vy, w1, w2, ax, ay, b1, b2], strict=True))

    q1 = -position_gain * (a1 - speed_gain * (vx - setpoint)) - damping_gain * w1
    q2 = -position_gain * (a2 - landing) - damping_gain * w2
    b1, b2 = pair(
        a - x1 * x1 / mx - y1 * y1 / my,
        -1.0 * x1 * x2 / mx - y1 * y2 / my,
        d - x2 * x2 / mx - y2 * y2 / my,
        q1 - n1 + x1 * nx / mx + y1 * ny / my,
        q2 - n2 + x2 * nx / mx + y2 * ny / my,
    )
    flight = rates(-1.0 * (nx + x1 * b1 + x2 * b2) / mx, -1.0 * (ny + y1 * b1 + y2 * b2) / my, b1, b2)

    length, d_length = l1 * k2 + l2 * kb, -l1 * s2 * (1.0 + db)
    dd_length = -l1 * (k2 * (1.0 + db) + s2 * ddb)
    sf, kf = s1 * kb + k1 * sb, k1 * kb - s1 * sb
    tx, ty = length * s1 + l3 * sf, -1.0 * length * k1 - l3 * kf
    tx1, ty1, tx2, ty2 = -1.0 * ty, tx, d_length * s1 + l3 * db * kf, -1.0 * d_length * k1 + l3 * db * sf
    tx12, ty12 = -1.0 * ty2, tx2
    tx22 = dd_length * s1 + l3 * (ddb * kf - db * db * sf)
    ty22 = -1.0 * dd_length * k1 + l3 * (ddb * sf + db * db * kf)
    cx = -1.0 * (2.0 * tx12 * w1 * w2 + tx22 * w2 * w2 - tx * w1 * w1)
    cy = -1.0 * (2.0 * ty12 * w1 * w2 + ty22 * w2 * w2 - ty * w1 * w1)
    spring = -stiffness * (length - rest)
    bx, by = fx - spring * s1, fy + spring * k1
    rx, ry = nx + mx * cx, ny + my * cy
    e1, e2 = pair(
        a + mx * tx1 * tx1 + my * ty1 * ty1 - 2.0 * (x1 * tx1 + y1 * ty1),
        mx * tx1 * tx2 + my * ty1 * ty2 - (x1 * tx2 + x2 * tx1 + y1 * ty2 + y2 * ty1),
        d + mx * tx2 * tx2 + my * ty2 * ty2 - 2.0 * (x2 * tx2 + y2 * ty2),
        -1.0 * (tx1 * bx + ty1 * by) - n1 - x1 * cx - y1 * cy + tx1 * rx + ty1 * ry,
        -1.0 * (tx2 * bx + ty2 * by) - n2 - x2 * cx - y2 * cy + tx2 * rx + ty2 * ry,
    )
    ax, ay = cx - tx1 * e1 - tx2 * e2, cy - ty1 * e1 - ty2 * e2
    stance, load = rates(ax, ay, e1, e2), my * ay + y1 * e1 + y2 * e2 + ny

    def until(system: list[Any], event: Any, rising: bool) -> Any:
        way = hy.event_direction.positive if rising else hy.event_direction.negative
        return hy.taylor_adaptive(system, [0.0] * 7, tol=tolerance, t_events=[hy.t_event(event, direction=way)])

    fall, rise = until(flight, y + ty, False), until(flight, vy, False)
    sink, push = until(stance, vy, True), until(stance, load, False)
    impact = make_rates(numba.njit)[2]

    def follow(integrator: Any, state: Any, command: Any = (0.0, 0.0)) -> Any:
        integrator.time = 0.0
        integrator.state[:] = state
        if len(integrator.pars):
            integrator.pars[:] = command
        integrator.reset_cooldowns()
        outcome = integrator.propagate_until(2.0)[0]
        return integrator.state if outcome != hy.taylor_outcome.time_limit else np.full(7, np.nan)

    def hop(start: Any, command: Any) -> Any:
        state = follow(fall, [start[1], speed_gain * (start[0] - setpoint), landing, start[0], 0.0, 0.0, 0.0])
        state = impact(np.concatenate(([0.0], state)), p)[1:]
        if state[4] < 0:
            state = follow(sink, state)
        state = follow(rise, follow(push, state, command))
        return np.array([state[3], state[0]])

    return hop
