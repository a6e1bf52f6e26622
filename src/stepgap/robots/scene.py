"""What is drawn of a robot: points that move, links between them, and their positions at every tick."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from math import isfinite
from typing import Literal, NamedTuple

import numpy as np

from stepgap.plants.ticks.tick_table import TickTable
from stepgap.step import Array

Shade = Literal["body", "near", "far"]
"""Colour of a link: that of the body, or those of the limbs on the near and on the far side."""


class Link(NamedTuple):
    """A straight part between two points.

    Attributes:
        start: Name of a point.
        end: Name of another point.
        radius: Radius of the drawn cylinder [m].
        shade: Its colour.
    """

    start: str
    end: str
    radius: float
    shade: Shade = "body"


@dataclass(frozen=True)
class Scene:
    """A robot as points and links. z points up from the floor; the robot moves along x, or on a circle around z.

    Attributes:
        points: Radius of the ball that is drawn at a point [m], by the point's name; 0 for no ball.
        links: Parts between the points.
        body: Point that the view follows, and whose path is drawn.
        feet: Points that may touch the ground.
        height: Name of the state coordinate that is the height of the body; empty if there is none.
        circle: Radius of the circle on which the body moves counter-clockwise, from (0, −circle) on [m]; 0: along x.
        signals: Quantities that are drawn over time beside the robot, such as torques, with their units.
        foothold: Name of the context quantity that says where a foot stood along the track [m]; empty if there is none.

    Raises:
        ValueError: A link, the body or a foot is not one of the points, or a length is negative.
    """

    points: Mapping[str, float]
    links: tuple[Link, ...]
    body: str
    feet: tuple[str, ...] = ()
    height: str = ""
    circle: float = 0.0
    signals: Mapping[str, str] = field(default_factory=dict)
    foothold: str = ""

    def __post_init__(self) -> None:
        used = {self.body, *self.feet, *(end for link in self.links for end in link[:2])}
        if unknown := sorted(used - set(self.points)):
            raise ValueError(f"the points of a scene must contain {', '.join(unknown)}")
        sizes = (self.circle, *self.points.values(), *(link.radius for link in self.links))
        if not all(isfinite(size) and size >= 0 for size in sizes):
            raise ValueError("the radii of a scene must be finite and not negative")

    def index(self, point: str) -> int:
        """Row of a point in the positions."""
        return list(self.points).index(point)

    def progress(self, positions: Array) -> Array:
        """How far the body has come: its x [m] or, on a circle, its yaw [rad].

        Args:
            positions: Positions of the points; shape (…, P, 3) [m].
        """
        body = positions[..., self.index(self.body), :]
        return np.arctan2(body[..., 0], -body[..., 1]) if self.circle else body[..., 0]

    def displaced(self, positions: Array, by: float) -> Array:
        """Positions after a displacement along the track.

        Args:
            positions: Positions of the points; shape (…, 3) [m].
            by: Difference of the progress: a length [m] or, on a circle, an angle [rad].
        """
        if not self.circle:
            return positions + np.array([by, 0.0, 0.0])
        cos = np.cos(by)
        sin = np.sin(by)
        return positions @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


class GroundPieces(NamedTuple):
    """Straight pieces of an uneven ground along the track; places are the progress of the body as a length.

    Attributes:
        start: Where each piece begins [m]; shape (k,).
        end: Where it ends [m]; shape (k,).
        start_height: Height at its start [m]; shape (k,).
        end_height: Height at its end [m]; shape (k,).
        changed: Whether it is softer or more slippery, or the contrary, than the ground elsewhere; shape (k,).
    """

    start: Array
    end: Array
    start_height: Array
    end_height: Array
    changed: Array


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of a robot, frame by frame.

    Attributes:
        time: Increasing times [s]; shape (F,).
        step: Number of the step that is being executed; shape (F,).
        positions: Positions of the points of the scene; shape (F, P, 3) [m].
        touching: 1 where a foot of the scene touches the ground, else 0; shape (F, feet).
        ground: Height of the ground under the robot; shape (F,) [m].
        signals: Values of the signals of the scene; shape (F, signals).

    Raises:
        ValueError: There is no frame, the lengths differ, or a value is not finite.
    """

    time: Array
    step: Array
    positions: Array
    touching: Array
    ground: Array
    signals: Array

    def __post_init__(self) -> None:
        arrays = [getattr(self, field.name) for field in fields(self)]
        if {array.shape[:1] for array in arrays} != {self.time.shape[:1]} or not self.time.size:
            raise ValueError("a motion must have equally many frames of everything, at least one")
        if not all(np.isfinite(array).all() for array in arrays):
            raise ValueError("a motion must consist of finite numbers")

    @property
    def duration(self) -> float:
        """Time from the first frame to the last one [s]."""
        return float(self.time[-1] - self.time[0])

    def frame(self, share: float) -> int:
        """Index of the frame after a fraction (0…1) of the duration."""
        return min(int(np.searchsorted(self.time, self.time[0] + share * self.duration)), len(self.time) - 1)


class Kinematics(ABC):
    """Forward kinematics of a robot: from its ticks to the positions of its points."""

    @property
    @abstractmethod
    def scene(self) -> Scene:
        """The points of the robot and the links between them."""

    @property
    @abstractmethod
    def units(self) -> Mapping[str, str]:
        """Columns of the ticks that the plants of the robot report, with their units; the first one is the time."""

    @property
    @abstractmethod
    def tick(self) -> float:
        """Time between two ticks [s]."""

    @property
    def observed_units(self) -> Mapping[str, str]:
        """Columns of the ticks of `Simulation.observed_plant`; those of `units` come first."""
        return self.units

    @abstractmethod
    def motion(self, ticks: TickTable) -> Motion:
        """Motion in ticks: the true one if they have the columns of `observed_units`, else the measured one.

        Args:
            ticks: Ticks with a column `step`, at least one.

        Raises:
            ValueError: There is no tick, or a value is not finite.
        """

    @abstractmethod
    def at_section(self, state: Array) -> Array:
        """Positions of the points when the robot is at the section of its steps; shape (P, 3) [m].

        Args:
            state: State at the section; shape (n,).
        """

    def every(self, interval: float) -> int:
        """Number of ticks in an interval [s]; at least one."""
        return max(1, round(interval / self.tick))
