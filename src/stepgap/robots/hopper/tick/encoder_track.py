"""Jumps and standstill of one encoder, judged by its last readings alone; compiled like the control tick.

A link with inertia cannot change its angle between two readings and then continue as before. The *jump* of an interval
is its movement minus the mean of the movements in the intervals before and after it. It is known one reading later; a
change of speed, as by an impact, enters it with at most half its size.
"""

from math import copysign
from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import as_written

RESTLESS_KEPT = 0.8
"""Part of the largest change of torque that is kept from one reading to the next: a drive gives it some ticks later."""

STILL_COUNTS = 1.5
"""Distance from the anchor up to which an encoder stands still: one count, since a still link may be on an edge."""


JITTER_SHARE = 1.5
"""Largest jump that is seen where a reading is taken a tick too late, in movements per tick.

A link that moves by v in each tick then seems to move by v, 0, 2 v.
"""

NOISE_GAIN = 0.02
PACE_GAIN = 0.1
"""Weights of the latest reading in the means of `Counts`."""

NOISE_COUNTS = 3.0
MOST_NOISE = 1.5
"""Largest jump that counts, since one alone, as at an impact, is no noise [counts]; and largest mean square of the
jumps of an encoder that is not noisy [counts²] (1.0)."""

RESIDUES = 16
SWEPT = 64.0
SLOW_PACE = 1.0
"""The last four bits are watched, over this distance [counts], in which a healthy encoder shows all their values while
it moves slowly [counts per tick]; at two counts per tick, all readings may be even."""


class EncoderTrack(NamedTuple):
    """Last readings of an encoder.

    Attributes:
        readings: Number of readings, counted up to 3.
        time: Time of the latest reading [s].
        angle: Its angle [rad].
        took: Time between the two latest readings [s].
        movement: Angle between them [rad].
        took_before: Time between the two readings before [s].
        movement_before: Angle between these [rad].
        torque: Latest torque on the link [N·m].
        restless: Largest change of that torque from reading to reading, which decays in some readings [N·m].
        restless_before: The same at the reading before, on which the latest reading had no influence [N·m].
        anchor: Angle from which it last moved away [rad].
        still: Time for which it has stood still although it should have moved [s].
    """

    readings: int = 0
    time: float = 0.0
    angle: float = 0.0
    took: float = 0.0
    movement: float = 0.0
    took_before: float = 0.0
    movement_before: float = 0.0
    torque: float = 0.0
    restless: float = 0.0
    restless_before: float = 0.0
    anchor: float = 0.0
    still: float = 0.0


class Jump(NamedTuple):
    """What the latest reading says about jumps, in angles per tick; zero until there are enough readings.

    Attributes:
        size: Jump in the interval before the latest, positive in the direction of counting [rad].
        change: Change of the movement per tick in the latest interval, beyond that of an impact, which stops the link;
            it shows a large jump at once; positive in the direction of counting [rad].
        speed: Largest movement per tick of the intervals beside that of `size`, and half of that in it, since a reading
            may be a tick late [rad].
        pace: Larger movement per tick of the two intervals before that of `change` [rad].
        restless: Change of torque before the jump, which may cause a jump, too [N·m].
    """

    size: float
    change: float
    speed: float
    pace: float
    restless: float


NO_JUMP = Jump(size=0.0, change=0.0, speed=0.0, pace=0.0, restless=0.0)


@as_written
def with_angle(track, tick, count, time, angle, torque, should_move):
    """`EncoderTrack` with a reading, and its `Jump`; a reading that is not new changes nothing.

    Where frames were lost, an interval is longer, and so, by its square, is what acceleration alone can cause.

    Args:
        track: `EncoderTrack` before.
        tick: Time of a tick [s].
        count: Angle of a count [rad].
        time: Time of the reading [s].
        angle: Its angle [rad].
        torque: Torque on the link since the tick before [N·m].
        should_move: Whether something moves the link, so that standing still is counted.
    """
    if track.readings > 0 and time <= track.time:
        return track, NO_JUMP
    if track.readings == 0:
        first = EncoderTrack(
            readings=1, time=time, angle=angle, took=0.0, movement=0.0, took_before=0.0, movement_before=0.0,
            torque=torque, restless=0.0, restless_before=0.0, anchor=angle, still=0.0,
        )  # fmt: skip
        return first, NO_JUMP
    took = time - track.time
    movement = angle - track.angle
    size = change = speed = pace = 0.0
    longest = max(took, max(track.took, track.took_before)) / tick
    scale = 1.0 / max(1.0, longest * longest)
    if track.readings >= 2:
        before = track.movement / track.took
        bend = movement / took - before
        change = scale * tick * copysign(max(0.0, abs(bend) - abs(before)), bend)
        pace = tick * abs(before)
    if track.readings >= 3:
        before = track.movement_before / track.took_before
        latest = movement / took
        size = scale * (track.movement - 0.5 * (before + latest) * track.took)
        speed = tick * max(abs(before), max(abs(latest), 0.5 * abs(track.movement / track.took)))
        pace = max(pace, tick * abs(before))
    restless = max(RESTLESS_KEPT * track.restless, abs(torque - track.torque))
    anchor = track.anchor
    still = track.still
    if abs(angle - anchor) > STILL_COUNTS * count:
        anchor = angle
        still = 0.0
    elif should_move:
        still += took
    after = EncoderTrack(
        readings=min(track.readings + 1, 3), time=time, angle=angle, took=took, movement=movement,
        took_before=track.took, movement_before=track.movement, torque=torque, restless=restless,
        restless_before=track.restless, anchor=anchor, still=still,
    )  # fmt: skip
    return after, Jump(size=size, change=change, speed=speed, pace=pace, restless=track.restless_before)


class Counts(NamedTuple):
    """Slow means and last digits of an encoder's counts, by which noise and stuck bits show, however small they are.

    Attributes:
        square: Mean square of its jumps [counts²]; rounding alone gives 0.13, and 1 at a half count per tick.
        pace: Mean movement per tick [counts].
        begin: Count from which its slow movement is measured.
        seen: Remainders of the counts modulo `RESIDUES` since then, a bit each.
        stuck: Whether half of them or more were missing when it had last moved by `SWEPT`.
    """

    square: float = 0.0
    pace: float = 0.0
    begin: float = np.nan
    seen: int = 0
    stuck: int = 0


@as_written
def with_count(counts, tick, unit, value, track, jump):
    """`Counts` with a new reading, which made this `EncoderTrack` and this `Jump`.

    Args:
        counts: `Counts` before.
        tick: Time of a tick [s].
        unit: Angle of a count [rad].
        value: The reading [counts].
        track: `EncoderTrack` with it.
        jump: `Jump` of it.
    """
    size = min(abs(jump.size) / unit, NOISE_COUNTS)
    latest = tick * track.movement / (track.took * unit) if track.took > 0.0 else 0.0
    pace = counts.pace + PACE_GAIN * (latest - counts.pace)
    begin = counts.begin
    seen = counts.seen | 1 << int(value % RESIDUES)
    stuck = counts.stuck
    if np.isnan(begin) or abs(pace) > SLOW_PACE:
        begin = value
        seen = 0
    elif abs(value - begin) > SWEPT:
        begin = value
        stuck = int(2 * _number_of_bits(seen) <= RESIDUES)
        seen = 0
    square = counts.square + NOISE_GAIN * (size * size - counts.square)
    return Counts(square=square, pace=pace, begin=begin, seen=seen, stuck=stuck)


@as_written
def _number_of_bits(mask):
    number = 0
    for bit in range(RESIDUES):
        number += mask >> bit & 1
    return number


@as_written
def is_noisy(counts, jitter):
    """Whether an encoder is noisy or has a stuck bit, if its readings may be wrong in time by `jitter` ticks."""
    moved = JITTER_SHARE * jitter * counts.pace
    return counts.stuck == 1 or counts.square > MOST_NOISE + moved * moved


@as_written
def may_rest(track):
    """`EncoderTrack` of a link that may stand still, so that the time of standing still begins again at zero."""
    return EncoderTrack(
        readings=track.readings, time=track.time, angle=track.angle, took=track.took, movement=track.movement,
        took_before=track.took_before, movement_before=track.movement_before, torque=track.torque,
        restless=track.restless, restless_before=track.restless_before, anchor=track.anchor, still=0.0,
    )  # fmt: skip
