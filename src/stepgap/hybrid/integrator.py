"""Adaptive integration up to the next event, accurate at the event; knows no robot.

A motion with impacts and switches is a chain of smooth pieces. `integrate` runs one piece: from a state to where the
first of its *guards* ceases to be positive, scalar functions of the state that mark where the smooth piece ends
(contact, a switch in the control law, saturation). A step never straddles a guard, so the order of the method is kept
(see Hairer, Nørsett, Wanner, Solving ODEs I, II.6).

It notes the sizes of its steps. `retrace` takes the same steps from a neighbouring state and ends where that motion
meets the guard itself: a smooth function of the state, whose differences are free of the noise that step size control
makes. They are the derivatives of the motion, events included (H. G. Bock's internal differentiation).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stepgap.base.compiled import compiled, generic
from stepgap.hybrid.motion import axpy, hermite, rate_and_guards, rate_jacobian
from stepgap.hybrid.rosenbrock import rosenbrock_step
from stepgap.hybrid.tsitouras import tsitouras_step

TIME_OUT = -1
"""`integrate` reached the time limit before any event."""
BROKEN = -2
"""`integrate` met a state or rate that is not finite, or needed too many steps."""

MAX_STEPS = 20_000
MAX_PIECES = 200
_GROWTH = 5.0
"""By how much a step may be longer than the one before."""
AIM = 1e-5
"""How well an event is located on the interpolant of a step, relative to the guard's values around it."""
DIP_MARGIN = 0.2
"""How near zero the parabola through three values of a guard must come for its vertex to be looked at."""
LEAVING = 1e-3
"""Fraction of a step after which a guard that the piece began on must be positive."""


class Tolerance(NamedTuple):
    """Local error allowed per step: absolute + relative · |state|."""

    relative: float
    absolute: float


class Trace(NamedTuple):
    """The steps taken by a chain of pieces; allocated once, for any number of chains.

    Attributes:
        sizes: Sizes of the steps of all pieces [s]; shape (MAX_STEPS,).
        pieces: For each piece the place in `sizes` where it ends, and its event; shape (MAX_PIECES, 2).
        place: Steps and pieces noted or retraced so far; shape (2,).
    """

    sizes: NDArray[np.float64]
    pieces: NDArray[np.int64]
    place: NDArray[np.int64]


@compiled
def make_trace():
    """An empty `Trace`."""
    return Trace(np.empty(MAX_STEPS), np.empty((MAX_PIECES, 2), np.int64), np.zeros(2, np.int64))


@compiled
def rewind(trace):
    """Goes back to the start of the trace: to note a new chain, or to retrace the one that is noted."""
    trace.place[:] = 0


@generic
def _step(system, time, state, here, jacobian, h):
    """A step of size h by the method that suits the piece: (end, (rate, guards) there, local error)."""
    if jacobian is None:
        return tsitouras_step(system, time, state, here, h)
    return rosenbrock_step(system, time, state, here, jacobian, h)


@compiled
def _scaled(error, start, end, tolerance):
    """Root-mean-square local error over the tolerance; 1 is just allowed."""
    total = 0.0
    for i in range(4):
        scale = tolerance.absolute + tolerance.relative * max(abs(start[i]), abs(end[i]))
        total += (error[i] / scale) ** 2
    size = np.sqrt(0.25 * total)
    return size if np.isfinite(size + end[0] + end[1] + end[2] + end[3]) else np.inf


class Span(NamedTuple):
    """A step that was taken, with its cubic interpolant.

    Attributes:
        time: At its start [s].
        h: Its size [s].
        start: State at its start.
        here: Rate there.
        end: State at its end.
        there: Rate there.
    """

    time: float
    h: float
    start: tuple
    here: tuple
    end: tuple
    there: tuple


@generic
def _guard_at(system, span, s):
    """Guards at fraction s of a step."""
    return rate_and_guards(
        system, span.time + s * span.h, hermite(span.start, span.here, span.end, span.there, span.h, s)
    )[1]


@compiled
def _dip(first, middle, last):
    """Fraction of a step where a guard that is positive at three places may touch zero in between; 0 if nowhere.

    That is the vertex of a parabola, if it comes near zero.
    """
    bend = 2.0 * (first + last - 2.0 * middle)
    slope = 4.0 * middle - 3.0 * first - last
    if not (bend > 0.0 and -2.0 * bend < slope < 0.0):
        return 0.0
    return -0.5 * slope / bend if first - 0.25 * slope * slope / bend < DIP_MARGIN * max(first, last) else 0.0


@generic
def _crossing(system, span, first, last):
    """Earliest end of a guard's positive side within a step: (fraction of the step, guard), guard −1 if none.

    The guards are looked at in the middle of the step, too, and where they come near zero in between: one that is
    met there and left again before the end has been met all the same.

    Args:
        system: Constants of the piece.
        span: The step.
        first: Guards at its start.
        last: Guards at its end.
    """
    middle, earliest, which = _guard_at(system, span, 0.5), 2.0, -1
    for j in range(len(last)):
        low, g_low, high, g_high = 0.0, max(first[j], 0.0), 0.5, middle[j]
        if not g_high < 0.0:  # nor NaN
            low, g_low, high, g_high = 0.5, g_high, 1.0, last[j]
        if not g_high < 0.0:
            high = _dip(first[j], middle[j], last[j])
            if high == 0.0:
                continue
            g_high = _guard_at(system, span, high)[j]
            if not g_high < 0.0:
                continue
            if high < 0.5:
                low, g_low = 0.0, max(first[j], 0.0)
        fraction = _root(system, span, j, low, g_low, high, g_high)
        if fraction < earliest:
            earliest, which = fraction, j
    return earliest, which


@generic
def _root(system, span, which, low, g_low, high, g_high):
    """Fraction of a step where a guard is zero, by the Illinois method between two where its signs differ.

    A piece that begins on a guard leaves it first: that zero is not the one sought.
    """
    aim = AIM * (g_low - g_high)
    if low == 0.0 and g_low <= aim:
        low = LEAVING
        g_low = _guard_at(system, span, low)[which]
        if not g_low > 0.0:
            return 0.0
    side = 0
    for _ in range(30):
        s = (low * g_high - high * g_low) / (g_high - g_low)
        g = _guard_at(system, span, s)[which]
        if abs(g) <= aim:
            return s
        if g < 0.0:
            high, g_high, g_low = s, g, 0.5 * g_low if side < 0 else g_low
            side = -1
        else:
            low, g_low, g_high = s, g, 0.5 * g_high if side > 0 else g_high
            side = 1
    return high


@generic
def _drop(system, time, state, seen, which, begin, most):
    """Moves along the flow onto a guard nearby by Newton's method: (time, state) there.

    Rate and guard are observed once more a moment later; the differences give the slope of the guard and the second
    derivative of the state.

    Args:
        system: Constants of the piece.
        time: Since the start of the phase.
        state: Close to the guard.
        seen: (rate, guards) there.
        which: The guard.
        begin: Start of the piece [s].
        most: Farthest to go either way [s].
    """
    moment, earliest, latest = 1e-6, max(begin, time - most), time + most
    for _ in range(8):
        here, guards = seen
        later, guards_later = rate_and_guards(system, time + moment, axpy(state, moment, (1.0,), (here,)))
        fall = (guards[which] - guards_later[which]) / moment
        delay = guards[which] / fall if fall != 0.0 else 0.0
        delay = min(latest, max(earliest, time + delay)) - time
        half = 0.5 * delay / moment
        state, time = axpy(state, delay, (1.0 - half, half), (here, later)), time + delay
        if abs(delay) < 1e-10:
            break
        seen = rate_and_guards(system, time, state)
    return time, state


@generic
def integrate(system, time, state, time_limit, tolerance, h, trace):
    """Follows the flow to the first event and notes the steps.

    Args:
        system: Constants of the piece, for whose type `rate`, `rate_and_guards` and `rate_jacobian` are implemented.
        time: Start, since the beginning of the phase that the piece belongs to [s].
        state: State there.
        time_limit: Latest end [s].
        tolerance: `Tolerance` of a step.
        h: Size of the first step to try [s].
        trace: `Trace`.

    Returns:
        (time, state, event, h): the end; index of the guard met there, TIME_OUT or BROKEN; size of the step to go on
        with.
    """
    event, begin = BROKEN, time
    here, guards = rate_and_guards(system, time, state)
    jacobian = rate_jacobian(system, state, here)
    while trace.place[0] < MAX_STEPS and trace.place[1] < MAX_PIECES:
        h = min(h, time_limit - time)
        end, seen, error = _step(system, time, state, here, jacobian, h)
        size = _scaled(error, state, end, tolerance)
        if not size <= 1.0:
            h *= max(0.2, 0.9 * size**-0.2) if np.isfinite(size) else 0.1
            if h < 1e-12:
                break
            continue
        fraction, which = _crossing(system, Span(time, h, state, here, end, seen[0]), guards, seen[1])
        trace.sizes[trace.place[0]] = h
        trace.place[0] += 1
        if which >= 0:
            part = max(fraction, 1e-9) * h
            trace.sizes[trace.place[0] - 1] = part
            end, seen, _ = _step(system, time, state, here, jacobian, part)
            time, state = _drop(system, time + part, end, seen, which, begin, h)
            event = which
            break
        time, state, (here, guards) = time + h, end, seen
        if time >= time_limit:
            event = TIME_OUT
            break
        jacobian = rate_jacobian(system, state, here)
        h *= min(_GROWTH, 0.9 * max(size, 1e-8) ** -0.2)
    if trace.place[1] < MAX_PIECES:
        trace.pieces[trace.place[1], 0], trace.pieces[trace.place[1], 1] = trace.place[0], event
        trace.place[1] += 1
    return time, state, event, h


@generic
def retrace(system, time, state, trace):
    """Takes the noted steps of the next piece from another state, and ends on the same guard.

    Returns:
        (time, state, event) as `integrate`, whose event is the noted one.
    """
    begin, h = time, 0.0
    stop, event = trace.pieces[trace.place[1], 0], trace.pieces[trace.place[1], 1]
    seen = rate_and_guards(system, time, state)
    while trace.place[0] < stop:
        h = trace.sizes[trace.place[0]]
        end, seen, _ = _step(system, time, state, seen[0], rate_jacobian(system, state, seen[0]), h)
        time, state = time + h, end
        trace.place[0] += 1
    trace.place[1] += 1
    time, state = _drop(system, time, state, seen, event, begin, h)
    return time, state, event
