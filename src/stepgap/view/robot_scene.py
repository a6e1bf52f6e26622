"""The 3-D scene of a robot and of its ground."""

from math import atan2, cos, hypot, sin

import numpy as np
from viser import CylinderHandle, IcosphereHandle, MeshHandle, SceneApi

from stepgap.robots.scene import GroundPieces, Scene, Shade
from stepgap.step import Array

Colour = tuple[int, int, int]

DARK_RGB = (60, 62, 70)
BLUE_RGB = (0, 114, 178)
SKY_RGB = (86, 180, 233)
VERMILLION_RGB = (213, 94, 0)
LIGHT_RGB = (225, 227, 230)
TREAD_RGB = (190, 194, 200)
CHANGED_RGB = (233, 190, 100)

SHADES: dict[Shade, Colour] = {"body": DARK_RGB, "near": BLUE_RGB, "far": SKY_RGB}

TRACK_WIDTH = 0.16
MARK_EVERY = 0.1
"""Width of the marks on the track, and their distance [m]."""

AMBIENT_LIGHT = 2.0  # Intensity of the light that comes from all sides, beside viser's lamps

LONGEST_FLAT = 0.05
DEPTH = 0.02
"""Longest part of a piece of an uneven ground that is drawn flat, and how far the floor is below the lowest one [m]."""

TRACK_MARKS = 400  # Number of marks on a straight track on either side of the start


class RobotScene:
    """A robot in the scene.

    Args:
        api: Scene of the server, in which the robot is drawn.
        name: Name of its node.
        scene: Points and links of the robot.
        ghost: Whether it is drawn transparent.
    """

    def __init__(self, api: SceneApi, name: str, scene: Scene, ghost: bool = False):
        self._root = api.add_frame(name, show_axes=False)
        look = {"opacity": 0.35, "cast_shadow": False, "receive_shadow": False} if ghost else {}

        def colour(shade: Shade) -> Colour:
            return VERMILLION_RGB if ghost else SHADES[shade]

        self._links: list[tuple[int, int, CylinderHandle]] = []
        for number, link in enumerate(scene.links):
            handle = api.add_cylinder(f"{name}/link_{number}", link.radius, 1.0, colour(link.shade), **look)
            self._links.append((scene.index(link.start), scene.index(link.end), handle))
        self._scene = scene
        self._balls: dict[str, IcosphereHandle] = {
            point: api.add_icosphere(f"{name}/{point}", radius, colour("body"), **look)
            for point, radius in scene.points.items()
            if radius
        }

    def show(self, positions: Array) -> None:
        """Draws the robot with its points at these positions; shape (P, 3) [m]."""
        for start, end, handle in self._links:
            along = positions[end] - positions[start]
            handle.position = (positions[start] + positions[end]) / 2
            handle.wxyz = turned_to(along)
            length = round(float(np.linalg.norm(along)), 6)
            if handle.height != length:  # most links are rigid
                handle.height = length
        for point, handle in self._balls.items():
            handle.position = positions[self._scene.index(point)]
        self._root.visible = True

    def hide(self) -> None:
        """Hides the robot."""
        self._root.visible = False


def light(api: SceneApi) -> None:
    """Lights the scene from all sides; an environment map would take seconds without a graphics card."""
    api.configure_environment_map(None)
    api.add_light_ambient("/light", intensity=AMBIENT_LIGHT)


class Ground:
    """The floor, with marks on the track of the robot, or with the pieces of an uneven ground upon it.

    Args:
        api: Scene of the server, in which the floor is drawn.
        name: Name of its node.
        scene: Scene of the robot, which determines the track.
    """

    def __init__(self, api: SceneApi, name: str, scene: Scene):
        self._api = api
        self._name = name
        self._scene = scene
        self._root = api.add_frame(name, show_axes=False)
        self._pieces: GroundPieces | None = None
        self._solids: list[MeshHandle] = []
        if scene.circle:
            radius = 1.6 * scene.circle
            api.add_cylinder(f"{name}/floor", radius, 0.02, LIGHT_RGB, position=(0, 0, -0.011), cast_shadow=False)
        else:
            size = (2 * TRACK_MARKS * MARK_EVERY, 4.0, 0.02)
            api.add_box(f"{name}/floor", LIGHT_RGB, size, position=(0, 0, -0.011), cast_shadow=False)
        lines = _circle(scene.circle) if scene.circle else _straight()
        raised = (lines + np.array([0, 0, 0.001])).astype(np.float32)
        api.add_line_segments(f"{name}/marks", raised, (150, 153, 160), thickness=0.004)

    def show(self, height: float, pieces: GroundPieces | None = None) -> None:
        """Moves the floor to its height under the robot [m], or below the pieces of an uneven ground."""
        if pieces is not self._pieces:
            self._build(pieces)
        self._root.position = (0.0, 0.0, height if pieces is None else _lowest(pieces))

    def _build(self, pieces: GroundPieces | None) -> None:
        """Puts the pieces of an uneven ground in the place of others."""
        for solid in self._solids:
            solid.remove()
        self._pieces = pieces
        self._solids = []
        if pieces is None:
            return
        for changed, colour in ((False, TREAD_RGB), (True, CHANGED_RGB)):
            rows = np.flatnonzero(pieces.changed == changed)
            if len(rows):
                chosen = GroundPieces(*(column[rows] for column in pieces))
                vertices, faces = _solid(chosen, _lowest(pieces), self._scene)
                name = f"{self._name}/{'changed' if changed else 'pieces'}"
                self._solids.append(
                    self._api.add_mesh_simple(name, vertices, faces, color=colour, flat_shading=True, side="double")
                )


def _lowest(pieces: GroundPieces) -> float:
    """Height of the floor below the pieces of a ground [m]."""
    return float(min(pieces.start_height.min(), pieces.end_height.min())) - DEPTH


def _solid(pieces: GroundPieces, floor: float, scene: Scene) -> tuple[Array, Array]:
    """Blocks from a floor up to the pieces of a ground.

    Args:
        pieces: The pieces, at least one.
        floor: Height of the floor [m].
        scene: Scene of the robot, which determines the track.

    Returns:
        Corners relative to the floor, shape (k, 3) [m], and triangles between them, shape (t, 3).
    """
    corners = []
    faces = []
    first = 0
    for start, end, low, high, _ in zip(*pieces, strict=True):
        count = 1 + max(1, int(np.ceil((end - start) / LONGEST_FLAT)))
        rows = _cross_sections(np.linspace(start, end, count), np.linspace(low, high, count) - floor, scene)
        edges = first + 4 * np.arange(count - 1)[:, None] + np.array([[0, 1], [1, 2], [3, 0]])[:, None]
        near = edges
        far = edges + 4
        faces += [
            np.concatenate([near, far[..., :1]], axis=-1),
            np.concatenate([far[..., ::-1], near[..., 1:]], axis=-1),
        ]
        ends = first + np.array([0, 4 * (count - 1)])[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
        faces.append(ends)
        corners.append(rows.reshape(-1, 3))
        first += 4 * count
    return np.concatenate(corners), np.concatenate([triangles.reshape(-1, 3) for triangles in faces])


def _cross_sections(place: Array, height: Array, scene: Scene) -> Array:
    """Upper corners, left and right, and lower ones, right and left, of a block along the track; shape (k, 4, 3)."""
    across = TRACK_WIDTH / 2 * np.array([1.0, -1.0, -1.0, 1.0])
    along, left = np.broadcast_arrays(place[:, None], across)
    up = height[:, None] * np.array([1.0, 1.0, 0.0, 0.0])
    if not scene.circle:
        return np.stack([along, left, up], axis=-1)
    radius = scene.circle - left
    yaw = along / scene.circle
    return np.stack([radius * np.sin(yaw), -radius * np.cos(yaw), up], axis=-1)


def _half_widths(count: int) -> Array:
    """Half the width of each mark, of which every tenth is longer; shape (count, 1) [m]."""
    return TRACK_WIDTH / 2 * np.where(np.arange(count) % 10 == 0, 1.0, 1 / 3)[:, None]


def _circle(radius: float) -> Array:
    """Segments of a circular track and its marks; shape (2 count, 2, 3) [m]."""
    count = round(2 * np.pi * radius / MARK_EVERY)
    angles = 2 * np.pi * np.arange(count) / count
    outward = np.stack([np.sin(angles), -np.cos(angles), np.zeros(count)], axis=-1)
    circle = np.stack([radius * outward, radius * np.roll(outward, 1, axis=0)], axis=1)
    half = _half_widths(count)
    marks = np.stack([(radius - half) * outward, (radius + half) * outward], axis=1)
    return np.concatenate([circle, marks])


def _straight() -> Array:
    """Segments of a straight track and its marks; shape (count, 2, 3) [m]."""
    count = 2 * TRACK_MARKS + 1
    x = MARK_EVERY * np.arange(-TRACK_MARKS, TRACK_MARKS + 1.0)
    half = _half_widths(count)[:, 0]
    none = np.zeros(count)
    marks = np.stack([np.stack([x, side * half, none], axis=-1) for side in (-1, 1)], axis=1)
    return np.concatenate([np.array([[[x[0], 0.0, 0.0], [x[-1], 0.0, 0.0]]]), marks])


def turned_to(direction: Array) -> Array:
    """Quaternion (w, x, y, z) of the shortest rotation from +z to a direction; shape (4,)."""
    x, y, z = direction
    azimuth = atan2(y, x)
    half_angle = atan2(hypot(x, y), z) / 2
    return np.array([cos(half_angle), -sin(azimuth) * sin(half_angle), cos(azimuth) * sin(half_angle), 0.0])
