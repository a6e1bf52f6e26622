"""Uneven ground of the twin, compiled: which tread is under the foot, and where ground and riser are put.

Only the foot collides. There is one plane for the tread under it and one for the nearest riser, which are moved before
each physics step; with a foot that small, that is the same as solid stairs.
"""

from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import as_written
from stepgap.step import Array

TREAD_START, TREAD_HEIGHT, TREAD_SLOPE, _IMPEDANCE, _SPRING, _DAMPER, _SLIP, _FRICTION = range(8)
"""Columns of a table of treads: place at which it begins [m], height there [m], rise over length, and the contact."""

LOWEST_RISER = 1e-5  # Smallest difference of height from a tread to the next that stops the foot [m]
_AWAY = -100.0  # Height of a riser that the foot is not near [m]


class UnevenViews(NamedTuple):
    """Treads, and views of what MuJoCo moves with them.

    Attributes:
        treads: Table of treads, in the order of their places; shape (k, 8), k = 0 on flat ground.
        length: Length after which the ground repeats [m].
        under: Number of the tread that is under the foot; shape (1,).
        turn: Orientation of the ground as a quaternion; shape (4,).
        riser: Position of the riser [m]; shape (3,), or (0,) without any.
        riser_turn: Its orientation as a quaternion; shape (4,).
        impedance: Impedance of the contact with the ground; shape (5,).
        spring: Its spring and damper; shape (2,).
        slip: Those of its friction; shape (2,).
        friction: Its coefficients of friction; shape (5,).
    """

    treads: Array
    length: float
    under: Array
    turn: Array
    riser: Array
    riser_turn: Array
    impedance: Array
    spring: Array
    slip: Array
    friction: Array


@as_written
def along_tread(uneven, tread, place):
    """Distance from the start of a tread to a place [m]; negative, or more than its length, for the nearer end."""
    distance = (place - uneven.treads[tread, TREAD_START]) % uneven.length
    rest = uneven.length - _long(uneven, tread)
    return distance - uneven.length if distance > uneven.length - 0.5 * rest else distance


@as_written
def _long(uneven, tread):
    """Length of a tread [m]."""
    treads = uneven.treads
    end = treads[tread + 1, TREAD_START] if tread + 1 < len(treads) else uneven.length
    return end - treads[tread, TREAD_START]


@as_written
def tread_height(uneven, tread, place):
    """Height of a tread, or of what continues it, at a place [m]."""
    return uneven.treads[tread, TREAD_HEIGHT] + uneven.treads[tread, TREAD_SLOPE] * along_tread(uneven, tread, place)


@as_written
def _end_height(uneven, tread):
    """Height at the end of a tread [m]."""
    return uneven.treads[tread, TREAD_HEIGHT] + uneven.treads[tread, TREAD_SLOPE] * _long(uneven, tread)


@as_written
def tread_under(uneven, tread, place, height):
    """Number of the tread under a foot, or to which it falls.

    A foot that is deeper below the edge of the next tread than beyond it is stopped by the riser.

    Args:
        uneven: `UnevenViews`.
        tread: The tread that was under it.
        place: Where it is [m].
        height: Its height [m].
    """
    count = len(uneven.treads)
    for _ in range(count):
        along = along_tread(uneven, tread, place)
        long = _long(uneven, tread)
        if count == 1 or 0.0 <= along < long:
            return tread
        if along >= long:
            following = (tread + 1) % count
            depth = along - long
            edge = uneven.treads[following, TREAD_HEIGHT]
        else:
            following = (tread - 1) % count
            depth = -along
            edge = _end_height(uneven, following)
        if edge - height > depth:
            return tread
        tread = following
    return tread


@as_written
def put_on_tread(uneven, tread):
    """Gives the ground the contact of a tread."""
    row = uneven.treads[tread]
    uneven.under[0] = tread
    uneven.impedance[0] = row[_IMPEDANCE]
    uneven.impedance[1] = row[_IMPEDANCE]
    uneven.spring[0] = row[_SPRING]
    uneven.spring[1] = row[_DAMPER]
    uneven.slip[1] = row[_SLIP]
    uneven.friction[0] = row[_FRICTION]
    uneven.friction[1] = row[_FRICTION]


@as_written
def tilt_ground(uneven, yaw):
    """Tilts the ground forward or backward by the slope of the tread under a foot at a yaw of the boom [rad]."""
    half = 0.5 * np.arctan(uneven.treads[int(uneven.under[0]), TREAD_SLOPE])
    turn = uneven.turn
    turn[0] = np.cos(half)
    turn[1] = np.sin(half) * np.sin(yaw)
    turn[2] = -np.sin(half) * np.cos(yaw)


@as_written
def move_riser(rig, uneven, foot, yaw, place, height):
    """Puts the riser at the nearest edge of the tread that is higher than the foot, else away.

    Args:
        rig: Record of `Devices`.
        uneven: `UnevenViews`.
        foot: Position of the foot in MuJoCo's frame [m]; shape (3,).
        yaw: Yaw of the boom there [rad].
        place: Where it is on the ground [m].
        height: Its height above the waves of the ground [m].
    """
    tread = int(uneven.under[0])
    count = len(uneven.treads)
    riser = uneven.riser
    turn = uneven.riser_turn
    along = along_tread(uneven, tread, place)
    long = _long(uneven, tread)
    following = (tread + 1) % count
    before = (tread - 1) % count
    ahead = long - along
    front = uneven.treads[following, TREAD_HEIGHT]
    rear = _end_height(uneven, before)
    stops_front = front > height and front > _end_height(uneven, tread) + LOWEST_RISER
    stops_rear = rear > height and rear > uneven.treads[tread, TREAD_HEIGHT] + LOWEST_RISER
    if stops_front and (ahead <= along or not stops_rear):
        distance = ahead
        side = 1.0
    elif stops_rear:
        distance = -along
        side = -1.0
    else:
        riser[0] = 0.0
        riser[1] = 0.0
        riser[2] = _AWAY
        turn[0] = 1.0
        turn[1] = 0.0
        turn[2] = 0.0
        turn[3] = 0.0
        return
    edge = yaw + distance / rig.boom_length if rig.boom_arc else 0.0
    if rig.boom_arc:
        riser[0] = rig.boom_length * np.sin(edge)
        riser[1] = -rig.boom_length * np.cos(edge)
        riser[2] = 0.0
    else:
        riser[0] = foot[0] + distance
        riser[1] = 0.0
        riser[2] = 0.0
    root = np.sqrt(0.5)
    turn[0] = root
    turn[1] = side * root * np.sin(edge)
    turn[2] = -side * root * np.cos(edge)
    turn[3] = 0.0
