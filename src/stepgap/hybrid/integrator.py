"""Adaptive integration up to the next event, accurate at the event; knows no robot.

A motion with impacts and switches is a chain of smooth pieces. `integrate` runs one piece: from a
state to the first sign change of any of its *guards*, scalar functions of the state that mark where
the smooth piece ends (contact, a switch in the control law, saturation). A step never straddles a
guard, so the order of the method is kept (see Hairer, Nørsett, Wanner, Solving ODEs I, II.6).

Method: Tsitouras 5(4), first same as last (Ch. Tsitouras, Computers & Mathematics with Applications
62, 2011).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stepgap.hybrid.compiled import compiled, generic

Array = NDArray[np.float64]

TIME_OUT = -1
"""`integrate` reached the time limit before any event."""
BROKEN = -2
"""`integrate` met a state or rate that is not finite, or needed too many steps."""

MAX_STEPS = 20_000

A21 = 0.161
A31, A32 = -0.008480655492356989, 0.335480655492357
A41, A42, A43 = 2.8971530571054935, -6.359448489975075, 4.3622954328695815
A51, A52, A53, A54 = 5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525
A61, A62, A63, A64, A65 = (
    5.86145544294642,
    -12.92096931784711,
    8.159367898576159,
    -0.071584973281401,
    -0.028269050394068383,
)
B1, B2, B3, B4, B5, B6 = (
    0.09646076681806523,
    0.01,
    0.4798896504144996,
    1.379008574103742,
    -3.290069515436081,
    2.324710524099774,
)
E1, E2, E3, E4, E5, E6, E7 = (
    -0.00178001105222577714,
    -0.0008164344596567469,
    0.007880878010261995,
    -0.1447110071732629,
    0.5823571654525552,
    -0.45808210592918697,
    0.015151515151515152,
)


class Tolerance(NamedTuple):
    """Local error allowed per step: absolute + relative · |state|."""

    relative: float
    absolute: float


class Workspace(NamedTuple):
    """Scratch arrays, allocated once per chain of pieces.

    Attributes:
        stages: Rates at the stages of a step; shape (7, n).
        trial: State at the end of a trial step; shape (n,).
        point: State inside a step; shape (n,).
        guard: Guard values there; shape (k,).
        seen: Guard values where a crossing was looked for; shape (k,).
        signs: Side of each guard the motion is on, ±1; shape (k,).
    """

    stages: Array
    trial: Array
    point: Array
    guard: Array
    seen: Array
    signs: Array


def rate(system, state, out):
    """Writes the time derivative of `state` into `out`; see `implements`.

    Args:
        system: A NamedTuple of the constants of one smooth piece; its type selects the implementation.
        state: Shape (n,).
        out: Shape (n,).
    """
    raise TypeError(f"no rate is implemented for {type(system).__name__}")


def guards(system, state, out):
    """Writes the guard values at `state` into `out`, shape (k,); see `implements`."""
    raise TypeError(f"no guards are implemented for {type(system).__name__}")


@compiled
def make_workspace(states, guards):
    """Workspace for up to `states` states and `guards` guards."""
    return Workspace(
        np.empty((7, states)),
        np.empty(states),
        np.empty(states),
        np.empty(guards),
        np.empty(guards),
        np.empty(guards),
    )


@generic
def take_sides(system, state, work):
    """Sets the side of each guard from the state; call it once at the start of a piece."""
    guards(system, state, work.guard)
    for i in range(work.signs.size):
        work.signs[i] = 1.0 if work.guard[i] > 0 else -1.0


@generic
def _step(system, state, h, work):
    """One Tsitouras step of size h from `state`, whose rate is in stages[0], into `trial`."""
    k, y, z, n = work.stages, work.trial, work.point, state.size
    for i in range(n):
        z[i] = state[i] + h * A21 * k[0, i]
    rate(system, z, k[1])
    for i in range(n):
        z[i] = state[i] + h * (A31 * k[0, i] + A32 * k[1, i])
    rate(system, z, k[2])
    for i in range(n):
        z[i] = state[i] + h * (A41 * k[0, i] + A42 * k[1, i] + A43 * k[2, i])
    rate(system, z, k[3])
    for i in range(n):
        z[i] = state[i] + h * (A51 * k[0, i] + A52 * k[1, i] + A53 * k[2, i] + A54 * k[3, i])
    rate(system, z, k[4])
    for i in range(n):
        z[i] = state[i] + h * (A61 * k[0, i] + A62 * k[1, i] + A63 * k[2, i] + A64 * k[3, i] + A65 * k[4, i])
    rate(system, z, k[5])
    for i in range(n):
        y[i] = state[i] + h * (B1 * k[0, i] + B2 * k[1, i] + B3 * k[2, i] + B4 * k[3, i] + B5 * k[4, i] + B6 * k[5, i])
    rate(system, y, k[6])


@compiled
def _scaled_error(state, h, tolerance, work):
    """Root-mean-square local error of the last step over the tolerance; 1 is just allowed."""
    k, y, total = work.stages, work.trial, 0.0
    for i in range(state.size):
        error = h * (
            E1 * k[0, i] + E2 * k[1, i] + E3 * k[2, i] + E4 * k[3, i] + E5 * k[4, i] + E6 * k[5, i] + E7 * k[6, i]
        )
        scale = tolerance.absolute + tolerance.relative * max(abs(state[i]), abs(y[i]))
        if not np.isfinite(scale):
            return np.inf
        total += (error / scale) ** 2
    return np.sqrt(total / state.size)


@generic
def _first_crossing(system, state, h, work):
    """Earliest guard crossing within the last step: (fraction of the step, guard, end), guard −1 if none.

    The guards are looked at in the middle of the step, too: one that is crossed there and crossed back
    before the end has been met all the same. The fraction is found on the cubic Hermite interpolant of
    the step; `end` is ½ or 1, where the guard is seen to be crossed.
    """
    earliest, which = 2.0, -1
    for end in (0.5, 1.0):
        _interpolate(state, h, end, work)
        guards(system, work.point, work.seen)
        for j in range(work.signs.size):
            if not work.seen[j] * work.signs[j] < 0:  # nor NaN
                continue
            low, high = end - 0.5, end
            for _ in range(30):
                s = 0.5 * (low + high)
                _interpolate(state, h, s, work)
                guards(system, work.point, work.guard)
                if work.guard[j] * work.signs[j] < 0:
                    high = s
                else:
                    low = s
            if high < earliest:
                earliest, which = high, j
        if which >= 0:
            return earliest, which, end
    return earliest, which, 1.0


@compiled
def _interpolate(state, h, s, work):
    """Cubic Hermite interpolant of the last step at fraction s into `point`."""
    h00, h10 = (1 + 2 * s) * (1 - s) ** 2, s * (1 - s) ** 2
    h01, h11 = s * s * (3 - 2 * s), s * s * (s - 1)
    for i in range(state.size):
        work.point[i] = h00 * state[i] + h01 * work.trial[i] + h * (h10 * work.stages[0, i] + h11 * work.stages[6, i])


@generic
def _land_on(system, state, h, crossing, work):
    """Shortens the last step so that it ends on the guard of `crossing`; returns its size."""
    fraction, which, end = crossing
    low, high = 0.0, end * h
    size, value = high, work.seen[which]
    better = fraction * h
    for _ in range(12):
        previous, previous_value, size = size, value, better
        _step(system, state, size, work)
        guards(system, work.trial, work.guard)
        value = work.guard[which]
        if value * work.signs[which] < 0:
            high = size
        else:
            low = size
        change = value - previous_value
        better = size - value * (size - previous) / change if change != 0.0 else size
        if not low <= better <= high:
            better = 0.5 * (low + high)
        if abs(value) < 1e-13 or abs(better - size) < 1e-15:
            break
    return size


@generic
def integrate(system, state, time_limit, tolerance, work):
    """Moves `state` along the flow to the first event.

    Args:
        system: Constants of the piece, for whose type `rate` and `guards` are implemented.
        state: Start, overwritten by the end; shape (n,).
        time_limit: Longest duration [s].
        tolerance: `Tolerance` of a step.
        work: `Workspace`; its `signs` must be set by `take_sides` at the start of the piece. The
            sign of the guard that was met is flipped, so that the piece can be gone on with.

    Returns:
        (elapsed, event): duration [s]; index of the guard met, TIME_OUT or BROKEN.
    """
    elapsed, h, k = 0.0, 1e-4, work.stages
    rate(system, state, k[0])
    for _ in range(MAX_STEPS):
        h = min(h, time_limit - elapsed)
        _step(system, state, h, work)
        error = _scaled_error(state, h, tolerance, work)
        if not np.isfinite(error):
            h *= 0.1
            if h < 1e-12:
                return elapsed, BROKEN
            continue
        if error > 1.0:
            h *= max(0.2, 0.9 * error**-0.2)
            continue
        crossing = _first_crossing(system, state, h, work)
        which = crossing[1]
        if which >= 0:
            elapsed += _land_on(system, state, h, crossing, work)
            state[:] = work.trial
            work.signs[which] = -work.signs[which]
            return elapsed, which
        elapsed += h
        state[:] = work.trial
        k[0, :] = k[6]
        if elapsed >= time_limit:
            return elapsed, TIME_OUT
        h *= min(5.0, 0.9 * max(error, 1e-8) ** -0.2)
    return elapsed, BROKEN
