"""The geoms of a MuJoCo model as points and links, and their positions in the ticks of a plant."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from stepgap.plants.ticks.tick_table import TickTable
from stepgap.robots.scene import Kinematics, Link, Motion, Scene, Shade
from stepgap.step import Array, StepSpace

TOUCHING_DISTANCE = 0.002  # Clearance of a foot below which it is drawn as touching the ground [m]

_PLANE, _HFIELD, _SPHERE, _CAPSULE, _CYLINDER = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")) for kind in ("PLANE", "HFIELD", "SPHERE", "CAPSULE", "CYLINDER")
)
_DRAWN_GROUPS = 3  # Geoms of the first groups are drawn, as in MuJoCo's viewer

_JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))

_JOINT_UNITS = {int(mujoco.mjtJoint.mjJNT_SLIDE): "m", int(mujoco.mjtJoint.mjJNT_HINGE): "rad"}


class _End(NamedTuple):
    """A point that is fixed to a geom.

    Attributes:
        geom: Number of the geom.
        offset: Position in the frame of the geom; shape (3,) [m].
        radius: Radius around the point [m].
    """

    geom: int
    offset: Array
    radius: float


class MjcfKinematics(Kinematics):
    """Kinematics of a MuJoCo model: a sphere is a ball, any other geom is a link along its longest axis.

    The robot moves along x. Its body is the first body of the model. Geoms of spheres and capsules that can collide are
    feet. The state coordinate `height`, if there is one, is taken to be the height of the body.

    Args:
        space: State and command of the robot.
        place: Puts the model, with its data, into a state at the section; it was reset before.
        tick: Time between two calls of the controller [s].
    """

    def __init__(self, model: Any, space: StepSpace, place: Callable[[Any, Any, Array], None], tick: float):
        self._model = model
        self._space = space
        self._place = place
        self._tick = tick
        self._data = mujoco.MjData(self._model)
        mujoco.mj_kinematics(self._model, self._data)
        drawn = _drawn(self._model)
        self._ends = {name: end for geom in drawn for name, end in _ends(self._model, geom).items()}
        self._feet = tuple(name for name, end in self._ends.items() if _can_touch(self._model, end.geom))
        self._signals = _signals(self._model)
        self._links = tuple(link for geom in drawn for link in _links(self._model, geom, self._data.geom_xpos[geom, 1]))

    @property
    def scene(self) -> Scene:
        """The geoms, and the frame of the first body."""
        linked = {link.start for link in self._links} | {link.end for link in self._links}
        points = {"body": 0.0} | {name: 0.0 if name in linked else end.radius for name, end in self._ends.items()}
        height = "height" if "height" in self._space.state_names else ""
        signals = dict(self._signals.values())
        return Scene(points, self._links, "body", self._feet, height, signals=signals)

    @property
    def units(self) -> Mapping[str, str]:
        """Time, generalised positions and control signals."""
        return tick_units(self._model)

    @property
    def tick(self) -> float:
        """Time between two calls of the controller [s]."""
        return self._tick

    def motion(self, ticks: TickTable) -> Motion:
        """Motion in ticks."""
        start = list(ticks.units).index("time") + 1
        positions = np.empty((len(ticks), 1 + len(self._ends), 3))
        for row, frame in zip(ticks.rows, positions, strict=True):
            self._data.qpos[:] = row[start : start + self._model.nq]
            mujoco.mj_kinematics(self._model, self._data)
            frame[:] = self._points()
        ends = list(self._ends)
        feet = [1 + ends.index(foot) for foot in self._feet]
        radii = np.array([self._ends[foot].radius for foot in self._feet])
        touching = positions[:, feet, 2] - radii < TOUCHING_DISTANCE
        signals = np.array([ticks[column] for column in self._signals]).reshape(-1, len(ticks)).T
        ground = np.zeros(len(ticks))
        return Motion(ticks["time"], ticks["step"], positions, touching.astype(float), ground, signals)

    def at_section(self, state: Array) -> Array:
        """Positions after `place`."""
        mujoco.mj_resetData(self._model, self._data)
        self._place(self._model, self._data, state)
        mujoco.mj_kinematics(self._model, self._data)
        return self._points()

    def _points(self) -> Array:
        """Positions of the points; shape (P, 3) [m]."""
        data = self._data
        ends = [data.geom_xpos[geom] + data.geom_xmat[geom].reshape(3, 3) @ at for geom, at, _ in self._ends.values()]
        return np.array([data.xpos[1], *ends])


def tick_units(model: Any) -> dict[str, str]:
    """Columns of a tick of a MuJoCo model with their units: time, `qpos_JOINT` and `ctrl_ACTUATOR`."""
    units = {"time": "s"}
    for number, size in enumerate(np.diff([*model.jnt_qposadr, model.nq])):
        name = model.joint(number).name or number
        unit = _JOINT_UNITS.get(int(model.jnt_type[number]), "")
        units |= {f"qpos_{name}{f'_{index}' if size > 1 else ''}": unit for index in range(size)}
    return units | {f"ctrl_{model.actuator(number).name or number}": "" for number in range(model.nu)}


def _signals(model: Any) -> dict[str, tuple[str, str]]:
    """Name and unit of each signal, by its column: positions of the joints that are driven, and control signals."""
    units = tick_units(model)
    driven = model.actuator_trnid[np.isin(model.actuator_trntype, _JOINT_TRANSMISSIONS), 0]
    joints = [model.joint(int(number)).name or number for number in driven]
    actuators = [model.actuator(number).name or number for number in range(model.nu)]
    columns = {f"qpos_{joint}": f"position of {joint}" for joint in joints}
    columns |= {f"ctrl_{actuator}": f"control of {actuator}" for actuator in actuators}
    return {column: (name, units[column]) for column, name in columns.items() if column in units}


def tick_row(data: Any) -> Sequence[float]:
    """Row of a tick; the columns are those of `tick_units`."""
    return (data.time, *data.qpos, *data.ctrl)


def _drawn(model: Any) -> list[int]:
    """Numbers of the geoms of the robot that are visible, or of all if none is, as without its meshes."""
    own = [k for k in range(model.ngeom) if model.geom_bodyid[k] > 0 and model.geom_type[k] not in (_PLANE, _HFIELD)]
    return [geom for geom in own if model.geom_group[geom] < _DRAWN_GROUPS] or own


def _can_touch(model: Any, geom: int) -> bool:
    """Whether a geom is round and can collide with the ground."""
    collides = bool(model.geom_contype[geom] | model.geom_conaffinity[geom])
    return collides and model.geom_type[geom] in (_SPHERE, _CAPSULE)


def _ends(model: Any, geom: int) -> dict[str, _End]:
    """The centre of a sphere, or the two ends of another geom along its longest axis, by name."""
    name = model.geom(geom).name or f"{model.body(model.geom_bodyid[geom]).name or 'body'}_{geom}"
    size = model.geom_size[geom]
    kind = model.geom_type[geom]
    if kind == _SPHERE:
        return {name: _End(geom, np.zeros(3), float(size[0]))}
    if kind in (_CAPSULE, _CYLINDER):
        centre = np.zeros(3)
        half = float(size[1])
        axis = 2
        radius = float(size[0])
    else:
        centre = model.geom_aabb[geom, :3]
        halves = model.geom_aabb[geom, 3:]
        axis = int(np.argmax(halves))
        half = float(halves[axis])
        radius = float(np.mean(np.delete(halves, axis)))
    along = half * np.eye(3)[axis]
    return {f"{name}_{side}": _End(geom, centre + sign * along, radius) for side, sign in (("a", -1), ("b", 1))}


def _links(model: Any, geom: int, y: float) -> list[Link]:
    """The link of a geom that is not a sphere; parts of the first body have its shade, others that of their side y."""
    ends = _ends(model, geom)
    if len(ends) == 1:
        return []
    start, end = ends
    shade: Shade = "far" if y > 1e-6 else "near"
    if model.geom_bodyid[geom] == 1:
        shade = "body"
    return [Link(start, end, ends[start].radius, shade)]
