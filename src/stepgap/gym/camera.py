"""Pictures of a robot from its scene: a camera that follows it and needs neither a screen nor OpenGL."""

from typing import Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from stepgap.plants.compiled_rig import Rows
from stepgap.plants.ticks.stream import OnTicks, numbered, thinned
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.report.drawing import BLACK, BLUE, GREY, LIGHT, SKY
from stepgap.report.own_style import own_style
from stepgap.robots.scene import Kinematics, Scene
from stepgap.step import Array

Picture = NDArray[np.uint8]
"""Red, green and blue; shape (height, width, 3)."""

PIXELS: Final = 480
"""Width and height of a picture; even, as most video encoders need it."""
PIXELS_PER_INCH: Final = 100
"""Resolution, which determines the size of the text."""

FRAMES_PER_SECOND: Final = 25
"""Pictures of one second of motion."""

TURN, TILT = np.deg2rad(25.0), np.deg2rad(12.0)
"""Direction of view: the angle from the side towards the front, and the angle from above."""

HEADROOM, FOOTROOM = 1.9, 0.25
"""Upper and lower end of the picture, as fractions of the height of the highest point; the floor is at zero."""

MARK_EVERY_METRE, MARK_WIDTH = 10, 0.05
"""Number of marks on a metre of the track, and their half width [m]."""

SHADE_COLOURS: Final = {"body": GREY, "near": BLUE, "far": SKY}


class Shot(NamedTuple):
    """What is in one picture.

    Attributes:
        positions: Positions of the points of the scene; shape (P, 3) [m].
        ground: Height of the ground under the robot [m].
        caption: Text above it.
    """

    positions: Array
    ground: float
    caption: str


@final
class Camera:
    """Collects the motion of a robot step by step, and draws it.

    Args:
        kinematics: Kinematics of the robot.
    """

    def __init__(self, kinematics: Kinematics):
        self.scene = kinematics.scene
        self._kinematics, self._rows = kinematics, list[Array]()
        self._shots: list[Shot] = []
        self._keep: OnTicks = self._thinned()
        self._top = 0.0

    def on_ticks(self, rows: Rows, step: int) -> None:
        """Called with the ticks of the plant, whose columns are those of `Kinematics.units`."""
        self._keep(rows, step)

    def begin(self, state: Array, caption: str) -> None:
        """Begins an episode at a state (n,); the ticks so far are dropped."""
        self._rows.clear()
        self._keep = self._thinned()
        positions = self._kinematics.at_section(state)
        self._top = self._top or float(positions[:, 2].max())  # the same for all episodes
        self._shots = [Shot(positions, 0.0, caption)]

    def take(self, state: Array, caption: str) -> None:
        """Adds the motion of a step to its end in a state (n,); a plant without ticks shows this state only."""
        if not self._rows:
            self._shots.append(Shot(self._kinematics.at_section(state), 0.0, caption))
            return
        motion = self._kinematics.motion(TickTable({**self._kinematics.units, "step": ""}, np.array(self._rows)))
        self._rows.clear()
        pairs = zip(motion.positions, motion.ground, strict=True)
        self._shots += [Shot(positions, float(ground), caption) for positions, ground in pairs]

    def picture(self) -> Picture:
        """The newest picture."""
        with own_style():
            return draw_shot(self.scene, self._shots[-1], self._top)

    def pictures(self) -> list[Picture]:
        """All pictures since the last call."""
        shots, self._shots = self._shots[:-1], self._shots[-1:]
        with own_style():
            return [draw_shot(self.scene, shot, self._top) for shot in shots]

    def _thinned(self) -> OnTicks:
        """Function that keeps the ticks of `FRAMES_PER_SECOND` pictures with finite numbers, and drops the others."""

        def keep(rows: Rows, step: int) -> None:
            found = numbered(rows, step)
            self._rows.extend(found[np.isfinite(found).all(axis=1)])

        return thinned(keep, self._kinematics.every(1 / FRAMES_PER_SECOND))


def draw_shot(scene: Scene, shot: Shot, top: float) -> Picture:
    """Draws a robot from its side, a little from the front and from above, with the track that it moves along.

    Args:
        scene: Points and links of the robot.
        shot: Where they are.
        top: Height of its highest point, which determines the scale [m].
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # slow imports, needed only where pictures are wanted
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    figure = Figure(figsize=(PIXELS / PIXELS_PER_INCH, PIXELS / PIXELS_PER_INCH), dpi=PIXELS_PER_INCH)
    canvas, axes = FigureCanvasAgg(figure), figure.add_axes((0, 0, 1, 1))
    side = (HEADROOM + FOOTROOM) * top
    axes.set(xlim=(-side / 2, side / 2), ylim=(-FOOTROOM * top, HEADROOM * top))
    axes.set_axis_off()
    points_per_metre = 72 * PIXELS / PIXELS_PER_INCH / side
    progress = float(scene.progress(shot.positions))
    centred = scene.displaced(shot.positions, -progress)
    body = centred[scene.index(scene.body)]
    track = [_projected(line, body).T for line in _track(scene, progress, side, shot.ground)]
    axes.add_collection(LineCollection(track, colors=LIGHT, linewidths=1.0, zorder=0))
    ends = {name: centred[row] for row, name in enumerate(scene.points)}
    for link in scene.links:
        line = np.array([ends[link.start], ends[link.end]])
        width = max(1.0, 2 * link.radius * points_per_metre)
        style = {"color": SHADE_COLOURS[link.shade], "linewidth": width, "solid_capstyle": "round"}
        axes.plot(*_projected(line, body), **style, zorder=2 if link.shade == "near" else 1)
    for name, radius in scene.points.items():
        size = 2 * radius * points_per_metre
        axes.plot(*_projected(ends[name][None], body), color=BLACK, marker="o", markersize=size, zorder=3)
    axes.text(0.03, 0.97, shot.caption, transform=axes.transAxes, va="top", family="monospace", fontsize=9)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _track(scene: Scene, progress: float, width: float, ground: float) -> list[Array]:
    """The track near the body, which is at its middle, and the marks on it; each of shape (k, 3) [m]."""
    travelled = progress * (scene.circle or 1.0)
    marks = np.arange(np.ceil((travelled - width) * MARK_EVERY_METRE), (travelled + width) * MARK_EVERY_METRE)
    along, half = np.linspace(-width, width, 40), MARK_WIDTH
    across = [np.array([[at, -half], [at, half]]) for at in marks / MARK_EVERY_METRE - travelled]
    return [_on_floor(scene, line, ground) for line in [np.stack([along, 0 * along], axis=-1), *across]]


def _on_floor(scene: Scene, line: Array, ground: float) -> Array:
    """Points of the floor, from distances along the track and to its left; (k, 2) to (k, 3) [m]."""
    along, left = line.T
    height = np.full(len(line), ground)
    if not scene.circle:
        return np.stack([along, left, height], axis=-1)
    angle, radius = along / scene.circle, scene.circle - left
    return np.stack([radius * np.sin(angle), -radius * np.cos(angle), height], axis=-1)


def _projected(points: Array, body: Array) -> Array:
    """Coordinates in the picture, with the track below the body in its middle; (k, 3) to (2, k) [m]."""
    x, y, z = (points - [body[0], body[1], 0.0]).T
    right, away = x * np.cos(TURN) + y * np.sin(TURN), y * np.cos(TURN) - x * np.sin(TURN)
    return np.stack([right, z * np.cos(TILT) + away * np.sin(TILT)])
