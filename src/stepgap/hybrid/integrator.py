"""Adaptive integration up to the next event, accurate at the event; knows no robot.

A motion with impacts and switches is a sequence of smooth pieces. `integrate` computes one piece. The end of a piece is
defined by *guards*: scalar functions of the state that are positive within the piece (contact, a switch in the control
law, saturation). The piece ends at the first zero of a guard. No step crosses a guard, so the order of the method is
kept (see Hairer, Nørsett, Wanner, Solving ODEs I, II.6).

`integrate` records the sizes of its steps. `retrace` takes the same steps from a neighbouring state and ends where that
motion reaches the same guard. Its result is a smooth function of the state, so finite differences of it are free of the
noise of step size control. They are the derivatives of the motion, events included (H. G. Bock's internal numerical
differentiation).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stepgap.base.compiled import compiled, generic
from stepgap.hybrid.motion import axpy, hermite, rate_and_guards, rate_jacobian
from stepgap.hybrid.rosenbrock import rosenbrock_step
from stepgap.hybrid.tsitouras import tsitouras_step

TIME_OUT = -1  # `integrate` reached the time limit before any event
BROKEN = -2  # `integrate` found a state or rate that is not finite, or needed too many steps

MAX_STEPS = 20_000
MAX_PIECES = 200
_GROWTH = 5.0  # Largest ratio of the sizes of two consecutive steps
GUARD_TOLERANCE = 1e-5
"""Accuracy of an event on the interpolant of a step, relative to the guard's values around it."""
DIP_MARGIN = 0.2
"""The vertex of the parabola through three values of a guard is checked if it is below this fraction of the largest."""
DEPARTURE = 1e-3
"""Fraction of a step after which a guard that is zero at the start of the piece must be positive."""


class Tolerance(NamedTuple):
    """Largest local error of a step: absolute + relative · |state|."""

    relative: float
    absolute: float


class Trace(NamedTuple):
    """The recorded steps of a sequence of pieces; allocated once, for any number of sequences.

    Attributes:
        sizes: Sizes of the steps of all pieces [s]; shape (MAX_STEPS,).
        pieces: For each piece the index in `sizes` where it ends, and its event; shape (MAX_PIECES, 2).
        cursor: Numbers of steps and pieces recorded or retraced so far; shape (2,).
    """

    sizes: NDArray[np.float64]
    pieces: NDArray[np.int64]
    cursor: NDArray[np.int64]


@compiled
def make_trace():
    """Returns an empty `Trace`."""
    return Trace(np.empty(MAX_STEPS), np.empty((MAX_PIECES, 2), np.int64), np.zeros(2, np.int64))


@compiled
def rewind(trace):
    """Moves the cursor to the start of the trace, to record a new sequence or to retrace the recorded one."""
    trace.cursor[:] = 0


@generic
def _step(system, time, state, here, jacobian, h):
    """Takes a step of size h by the method that suits the piece: (end, (rate, guards) there, local error)."""
    if jacobian is None:
        return tsitouras_step(system, time, state, here, h)
    return rosenbrock_step(system, time, state, here, jacobian, h)


@compiled
def _scaled_error(error, start, end, tolerance):
    """Root-mean-square local error divided by the tolerance; 1 is the largest that is accepted."""
    total = 0.0
    for i in range(4):
        scale = tolerance.absolute + tolerance.relative * max(abs(start[i]), abs(end[i]))
        total += (error[i] / scale) ** 2
    size = np.sqrt(0.25 * total)
    return size if np.isfinite(size + end[0] + end[1] + end[2] + end[3]) else np.inf


class Span(NamedTuple):
    """An accepted step with its cubic interpolant.

    Attributes:
        time: Time at its start [s].
        h: Its size [s].
        start: State at its start.
        here: Rate at its start.
        end: State at its end.
        there: Rate at its end.
    """

    time: float
    h: float
    start: tuple
    here: tuple
    end: tuple
    there: tuple


@generic
def _guards_at(system, span, s):
    """Guards at fraction s of a step."""
    return rate_and_guards(
        system, span.time + s * span.h, hermite(span.start, span.here, span.end, span.there, span.h, s)
    )[1]


@compiled
def _dip(first, middle, last):
    """Fraction of a step where a guard that is positive at three points may become zero in between; 0 if there is none.

    It is the vertex of the parabola through the three values, if that is close to zero.
    """
    curvature = 2.0 * (first + last - 2.0 * middle)
    slope = 4.0 * middle - 3.0 * first - last
    if not (curvature > 0.0 and -2.0 * curvature < slope < 0.0):
        return 0.0
    return -0.5 * slope / curvature if first - 0.25 * slope * slope / curvature < DIP_MARGIN * max(first, last) else 0.0


@generic
def _crossing(system, span, first, last):
    """First zero of a guard within a step: (fraction of the step, index of the guard), with index −1 if there is none.

    The guards are also evaluated in the middle of the step, and at a minimum close to zero: a guard that is negative
    there ends the piece even if it is positive again at the end of the step.

    Args:
        system: Constants of the piece.
        span: The step.
        first: Guards at its start.
        last: Guards at its end.
    """
    middle = _guards_at(system, span, 0.5)
    earliest = 2.0
    which = -1
    for j in range(len(last)):
        low = 0.0
        g_low = max(first[j], 0.0)
        high = 0.5
        g_high = middle[j]
        if not g_high < 0.0:  # nor NaN
            low = 0.5
            g_low = g_high
            high = 1.0
            g_high = last[j]
        if not g_high < 0.0:
            high = _dip(first[j], middle[j], last[j])
            if high == 0.0:
                continue
            g_high = _guards_at(system, span, high)[j]
            if not g_high < 0.0:
                continue
            if high < 0.5:
                low = 0.0
                g_low = max(first[j], 0.0)
        fraction = _root(system, span, j, low, g_low, high, g_high)
        if fraction < earliest:
            earliest = fraction
            which = j
    return earliest, which


@generic
def _root(system, span, which, low, g_low, high, g_high):
    """Fraction of a step where a guard is zero, by the Illinois method between two fractions with different signs.

    A guard may be zero at the start of the piece; that zero is not the one sought.
    """
    tolerance = GUARD_TOLERANCE * (g_low - g_high)
    if low == 0.0 and g_low <= tolerance:
        low = DEPARTURE
        g_low = _guards_at(system, span, low)[which]
        if not g_low > 0.0:
            return 0.0
    side = 0
    # The guard is positive at `low` and negative at `high`. An end that stays twice in a row counts with half its
    # value: the secant then falls beyond the root, and the interval shrinks from both sides.
    for _ in range(30):
        s = (low * g_high - high * g_low) / (g_high - g_low)
        g = _guards_at(system, span, s)[which]
        if abs(g) <= tolerance:
            return s
        if g < 0.0:
            high = s
            g_high = g
            g_low = 0.5 * g_low if side < 0 else g_low
            side = -1
        else:
            low = s
            g_low = g
            g_high = 0.5 * g_high if side > 0 else g_high
            side = 1
    return high


@generic
def _to_guard(system, time, state, evaluated, which, begin, largest):
    """Moves along the flow to the zero of a nearby guard by Newton's method: (time, state) there.

    Rate and guard are evaluated again a short time later; the differences give the time derivative of the guard and the
    second derivative of the state.

    Args:
        system: Constants of the piece.
        time: Time since the start of the phase [s].
        state: State close to the guard.
        evaluated: (rate, guards) there.
        which: Index of the guard.
        begin: Start of the piece [s].
        largest: Largest change of the time in either direction [s].
    """
    dt = 1e-6
    earliest = max(begin, time - largest)
    latest = time + largest
    for _ in range(8):
        here, guards = evaluated
        later, guards_later = rate_and_guards(system, time + dt, axpy(state, dt, (1.0,), (here,)))
        decrease = (guards[which] - guards_later[which]) / dt
        delay = guards[which] / decrease if decrease != 0.0 else 0.0
        delay = min(latest, max(earliest, time + delay)) - time
        half = 0.5 * delay / dt
        state = axpy(state, delay, (1.0 - half, half), (here, later))
        time = time + delay
        if abs(delay) < 1e-10:
            break
        evaluated = rate_and_guards(system, time, state)
    return time, state


@generic
def integrate(system, time, state, time_limit, tolerance, h, trace):
    """Integrates to the first event and records the steps.

    Args:
        system: Constants of the piece, for whose type `rate`, `rate_and_guards` and `rate_jacobian` are implemented.
        time: Start time, since the beginning of the phase that the piece belongs to [s].
        state: State at the start.
        time_limit: Latest end [s].
        tolerance: `Tolerance` of a step.
        h: Size of the first step to try [s].
        trace: `Trace` to which the steps are added.

    Returns:
        (time, state, event, h): the end; index of the guard that is zero there, TIME_OUT or BROKEN; size of the first
        step of the next piece.
    """
    event = BROKEN
    begin = time
    here, guards = rate_and_guards(system, time, state)
    jacobian = rate_jacobian(system, state, here)
    # `here`, `guards` and `jacobian` are those at (time, state), and no guard has crossed zero since `begin`. Only
    # accepted steps enter the trace, the last one shortened to the event, so `retrace` gets there without choices.
    while trace.cursor[0] < MAX_STEPS and trace.cursor[1] < MAX_PIECES:
        h = min(h, time_limit - time)
        end, evaluated, error = _step(system, time, state, here, jacobian, h)
        size = _scaled_error(error, state, end, tolerance)
        if not size <= 1.0:
            h *= max(0.2, 0.9 * size**-0.2) if np.isfinite(size) else 0.1
            if h < 1e-12:
                break
            continue
        span = Span(time=time, h=h, start=state, here=here, end=end, there=evaluated[0])
        fraction, which = _crossing(system, span, guards, evaluated[1])
        trace.sizes[trace.cursor[0]] = h
        trace.cursor[0] += 1
        if which >= 0:
            part = max(fraction, 1e-9) * h
            trace.sizes[trace.cursor[0] - 1] = part
            end, evaluated, _ = _step(system, time, state, here, jacobian, part)
            time, state = _to_guard(system, time + part, end, evaluated, which, begin, h)
            event = which
            break
        time, state, (here, guards) = time + h, end, evaluated
        if time >= time_limit:
            event = TIME_OUT
            break
        jacobian = rate_jacobian(system, state, here)
        h *= min(_GROWTH, 0.9 * max(size, 1e-8) ** -0.2)
    if trace.cursor[1] < MAX_PIECES:
        trace.pieces[trace.cursor[1], 0], trace.pieces[trace.cursor[1], 1] = trace.cursor[0], event
        trace.cursor[1] += 1
    return time, state, event, h


@generic
def retrace(system, time, state, trace):
    """Takes the recorded steps of the next piece from another state, and ends at the same guard.

    Returns:
        (time, state, event) as `integrate`; the event is the recorded one.
    """
    begin = time
    h = 0.0
    stop = trace.pieces[trace.cursor[1], 0]
    event = trace.pieces[trace.cursor[1], 1]
    evaluated = rate_and_guards(system, time, state)
    while trace.cursor[0] < stop:
        h = trace.sizes[trace.cursor[0]]
        end, evaluated, _ = _step(system, time, state, evaluated[0], rate_jacobian(system, state, evaluated[0]), h)
        time = time + h
        state = end
        trace.cursor[0] += 1
    trace.cursor[1] += 1
    time, state = _to_guard(system, time, state, evaluated, event, begin, h)
    return time, state, event
