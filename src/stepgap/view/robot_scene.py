"""The 3-D scene of boom, leg and ground."""

from collections.abc import Mapping

import numpy as np
from viser import CylinderHandle, IcosphereHandle, SceneApi

from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.view.geometry import HopperPose, Joints, joints_at, turned_to

Colour = tuple[int, int, int]

DARK_RGB, BLUE_RGB, SKY_RGB, VERMILLION_RGB, LIGHT_RGB = (
    (60, 62, 70),
    (0, 114, 178),
    (86, 180, 233),
    (213, 94, 0),
    (225, 227, 230),
)

RADII: Mapping[str, float] = {
    "boom": 0.014,
    "front_top": 0.009,
    "rear_top": 0.009,
    "front_bottom": 0.007,
    "rear_bottom": 0.007,
}
"""Radii of the drawn links [m]."""

JOINT_RADII: Mapping[str, float] = {"front_knee": 0.012, "rear_knee": 0.012, "ankle": 0.010, "foot": 0.009}
BODY_RADIUS, BODY_WIDTH = 0.04, 0.07

TRACK_WIDTH, MARK_EVERY = 0.16, 0.1
"""Width of the marks on the circle, and their distance [m]."""


class RobotScene:
    """A robot in the scene.

    Args:
        scene: Scene in which the robot is drawn.
        name: Name of its node.
        robot: Lengths of the robot.
        pivot_height: Height of the boom's pivot [m].
        ghost: Whether it is drawn transparent.
    """

    def __init__(self, scene: SceneApi, name: str, robot: RobotParameters, pivot_height: float, ghost: bool = False):
        self._robot, self._pivot_height = robot, pivot_height
        self._root = scene.add_frame(name, show_axes=False)
        colours = {
            "boom": DARK_RGB,
            "front_top": BLUE_RGB,
            "rear_top": SKY_RGB,
            "front_bottom": BLUE_RGB,
            "rear_bottom": SKY_RGB,
        }
        look = {"opacity": 0.35, "cast_shadow": False, "receive_shadow": False} if ghost else {}
        ends = joints_at(robot, pivot_height, HopperPose(0.0, 0.0, 0.0, 0.5)).links
        lengths = {link: float(np.linalg.norm(end - start)) for link, (start, end) in ends.items()}
        self._links: dict[str, CylinderHandle] = {
            link: scene.add_cylinder(
                f"{name}/{link}", radius, lengths[link], VERMILLION_RGB if ghost else colours[link], **look
            )
            for link, radius in RADII.items()
        }
        dark = VERMILLION_RGB if ghost else DARK_RGB
        self._body = scene.add_cylinder(f"{name}/body", BODY_RADIUS, BODY_WIDTH, dark, **look)
        self._joints: dict[str, IcosphereHandle] = {
            joint: scene.add_icosphere(f"{name}/{joint}", radius, dark, **look) for joint, radius in JOINT_RADII.items()
        }

    def show(self, pose: HopperPose) -> None:
        """Draws the robot in a pose."""
        joints = joints_at(self._robot, self._pivot_height, pose)
        for link, (start, end) in joints.links.items():
            self._links[link].position, self._links[link].wxyz = (start + end) / 2, turned_to(end - start)
        self._body.position, self._body.wxyz = joints.hip, turned_to(_across(joints))
        for joint, handle in self._joints.items():
            handle.position = getattr(joints, joint)
        self._root.visible = True

    def hide(self) -> None:
        """Hides the robot."""
        self._root.visible = False


def _across(joints: Joints) -> np.ndarray:
    """Direction of the motors' axis, along the boom."""
    return joints.hip - joints.pivot


class Ground:
    """The floor under the boom, with marks on the circle, and the post of the pivot.

    Args:
        scene: Scene in which the floor is drawn.
        name: Name of its node.
        radius: Radius of the circle [m].
        pivot_height: Height of the boom's pivot [m].
    """

    def __init__(self, scene: SceneApi, name: str, radius: float, pivot_height: float):
        self._root = scene.add_frame(name, show_axes=False)
        scene.add_cylinder(f"{name}/floor", 1.6 * radius, 0.02, LIGHT_RGB, position=(0, 0, -0.011), cast_shadow=False)
        count = round(2 * np.pi * radius / MARK_EVERY)
        angles = 2 * np.pi * np.arange(count) / count
        outward = np.stack([np.sin(angles), -np.cos(angles), np.zeros(count)], axis=-1)
        circle = np.stack([radius * outward, radius * np.roll(outward, 1, axis=0)], axis=1)
        half_width = np.where(np.arange(count) % 10 == 0, TRACK_WIDTH, TRACK_WIDTH / 3)[:, None] / 2
        marks = np.stack([(radius - half_width) * outward, (radius + half_width) * outward], axis=1)
        lines = np.concatenate([circle, marks]) + np.array([0, 0, 0.001])
        scene.add_line_segments(f"{name}/marks", lines.astype(np.float32), (150, 153, 160), thickness=0.004)
        scene.add_cylinder(f"{name}/post", 0.03, pivot_height, DARK_RGB, position=(0, 0, pivot_height / 2))

    def show(self, height: float) -> None:
        """Moves the floor to its height under the foot [m]."""
        self._root.position = (0.0, 0.0, height)
