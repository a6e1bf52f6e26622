"""Uneven ground of a MuJoCo model, as boxes, and what the feet find on it."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections.abc import Sequence
from dataclasses import replace
from math import atan, cos, hypot, sin
from typing import Any, Final

import mujoco
import numpy as np

from stepgap.base.ranges import require
from stepgap.mujoco_robots.mjcf.mjcf_gap import soften
from stepgap.robots.ground import Treads, UnevenGround
from stepgap.step import ContextQuantity, StepSpace

GROUND_LENGTH: Final = 12.0  # Length after which the ground of a robot from MJCF repeats [m]

_BODY: Final = "uneven_ground"
_OVERLAP: Final = 1.0  # Length by which the boxes go on beyond both ends [m], more than a robot is long
_HALF_DEPTH: Final = 0.5  # Half of the height of a box [m]
_HALF_WIDTH: Final = 2.0  # Half of its width [m]
_LEVEL: Final = 0.5  # Smallest upward part of the normal of a contact with the ground; that with a riser is less


def above_ground(space: StepSpace, ground: UnevenGround) -> StepSpace:
    """A space whose coordinate `height`, if the ground is measured, is that above the ground under the feet.

    The context then has the mean height and place of the feet at their touchdown, and the slope of the line through
    them and those of the step before.
    """
    if not ground.is_measured:
        return space
    state = [replace(quantity, above="ground") if quantity.name == "height" else quantity for quantity in space.state]
    slope = ContextQuantity("slope", "", input_scale=0.1 * ground.inputs)
    measured = ContextQuantity("ground", "m"), ContextQuantity("foothold", "m"), slope
    return replace(space, state=tuple(state), context=(*space.context, *measured))


class BoxGround:
    """A model whose geom `floor` is replaced by boxes, one for each tread, on a body that is moved with the robot.

    A box has the contact of the floor with a foot; softer patches yield more, without memory. Its sides are
    perpendicular to its top, so a riser beside a ramp leans by the slope.

    Args:
        spec: The model, a `mujoco.MjSpec`, which is changed.
        feet: Names of the geoms that stand on the ground.
        treads: The ground, which repeats after `GROUND_LENGTH`.
    """

    def __init__(self, spec: Any, feet: Sequence[str], treads: Treads):
        self._treads = treads
        floor = spec.geom("floor")
        foot = spec.geom(feet[0])
        body = spec.worldbody.add_body(name=_BODY, mocap=True)
        ends = treads.ends(GROUND_LENGTH)
        for turn in (-1, 0, 1):
            for number, (start, end) in enumerate(zip(treads.start, ends, strict=True)):
                begin = start + turn * GROUND_LENGTH
                if begin < GROUND_LENGTH + _OVERLAP and end + turn * GROUND_LENGTH > -_OVERLAP:
                    _add_box(body, floor, foot, begin, end - start, number, treads)
        floor.contype = floor.conaffinity = 0
        self.model = spec.compile()

    def height(self, place: float) -> float:
        """Height of the ground at a place [m]."""
        return self._treads.height_at(place % GROUND_LENGTH)

    def put(self, data: Any, start: float) -> None:
        """Puts the ground under the robot, so that a place of it [m] is at the zero of x and z."""
        turns = np.floor((data.xpos[1, 0] + start) / GROUND_LENGTH)
        number = self.model.body(_BODY).mocapid[0]
        data.mocap_pos[number] = GROUND_LENGTH * turns - start, 0.0, -self.height(start)


def _add_box(body: Any, floor: Any, foot: Any, begin: float, length: float, number: int, treads: Treads) -> None:
    """Adds the box of a tread that begins at a place [m]."""
    slope = float(treads.slope[number])
    angle = -atan(treads.slope[number])
    middle = begin + length / 2
    top = float(treads.height[number]) + slope * length / 2
    box = body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(hypot(length, slope * length) / 2, _HALF_WIDTH, _HALF_DEPTH),
        pos=(middle - _HALF_DEPTH * sin(angle), 0.0, top - _HALF_DEPTH * cos(angle)),
        quat=(cos(angle / 2), 0.0, sin(angle / 2), 0.0),
    )
    for name in ("contype", "conaffinity", "condim", "solimp", "margin", "gap", "group", "rgba"):
        setattr(box, name, getattr(floor, name))
    box.priority = 1  # else MuJoCo mixes its contact with that of the foot, as it is mixed here
    solref = (np.array(floor.solref) + np.array(foot.solref))[None] / 2
    soften(solref, 1 / float(treads.stiffness[number]))
    box.solref = solref[0]
    box.friction = np.maximum(floor.friction, foot.friction) * [float(treads.friction[number]), 1, 1]


class Footholds:
    """Where the feet of a robot touch the ground, step by step.

    Args:
        feet: Names of the geoms that stand on the ground.

    Raises:
        ValueError: There are no feet.
    """

    def __init__(self, model: Any, feet: Sequence[str]):
        require(len(feet) > 0, "feet", list(feet), "be the geoms that stand on the ground, where that is measured")
        self._feet = np.array([model.geom(foot).id for foot in feet])
        self._before = dict[int, tuple[float, float]]()
        self._found = dict[int, tuple[float, float]]()

    def begin_step(self) -> None:
        """Begins a step, in which no foot has touched the ground yet."""
        self._before = self._found or self._before
        self._found = {}

    def have_landed(self, data: Any) -> bool:
        """Whether the last foot that touches the ground in this step has just done so; called at every tick."""
        missing = len(self._feet) - len(self._found)
        contacts = data.contact
        if not missing or not len(contacts.geom):
            return False
        for pair, point, frame in zip(contacts.geom, contacts.pos, contacts.frame, strict=True):
            for foot in np.intersect1d(pair, self._feet):
                if abs(frame[2]) > _LEVEL:
                    self._found.setdefault(int(foot), (float(point[0]), float(point[2])))
        return len(self._found) == len(self._feet)

    @property
    def context(self) -> tuple[float, float, float]:
        """Ground [m], foothold [m] and slope of this step, of the feet that have touched it; NaN if none has."""
        if not self._found:
            return np.nan, np.nan, np.nan
        place, ground = np.mean(list(self._found.values()), axis=0)
        points = np.array([*self._before.values(), *self._found.values()])
        across, up = (points - points.mean(axis=0)).T
        spread = across @ across
        return float(ground), float(place), float(across @ up / spread) if spread > 0 else 0.0
