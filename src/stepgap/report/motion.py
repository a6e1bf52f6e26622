"""The robot's motion in a deployment, at the frame rate of the replay."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from hashlib import sha256
from math import tau
from typing import Final

import numpy as np

from stepgap.plants.ticks.tick_table import TickTable
from stepgap.records.motion_file import check_channels, motion_path, read_motion, write_motion
from stepgap.records.run_folder import RunRecord
from stepgap.records.steps_csv import digest
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.sensors import HopperSensorModel
from stepgap.step import Array

RATE: Final = 100
"""Frames of a replay per second."""


@dataclass(frozen=True, eq=False)
class DeploymentMotion:
    """Motion of the hopper on its boom, frame by frame; arrays have shape (F,).

    Attributes:
        step: Number of the step that is being executed.
        travel: Distance of the hip along the circle [m].
        height: Height of the hip [m].
        alpha_1: Leg angle [rad].
        alpha_2: Half the angle between the top links [rad].
        force: Vertical ground force on the foot [N].

    Raises:
        ValueError: The arrays differ in length, are empty, or are not finite.
    """

    step: Array
    travel: Array
    height: Array
    alpha_1: Array
    alpha_2: Array
    force: Array

    def __post_init__(self) -> None:
        check_channels(self.channels)

    @property
    def channels(self) -> dict[str, Array]:
        """The arrays by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


@dataclass(frozen=True, eq=False)
class Replay:
    """Motions of a robot in several deployments.

    Attributes:
        motions: Motions by number of the deployment.
        robot: Lengths of its links and boom.
        pivot_height: Height of the boom's pivot above the ground [m].
    """

    motions: Mapping[int, DeploymentMotion]
    robot: RobotParameters
    pivot_height: float


def sensed_motion(ticks: TickTable, sensors: HopperSensorModel) -> DeploymentMotion:
    """Motion as measured by the sensors.

    Args:
        ticks: Ticks with a column `step`, `RATE` per second.
        sensors: Sensor model of the rig.

    Raises:
        ValueError: There is no tick, or the sensors were not read at one of them.
    """
    yaw = ticks["boom_horizontal"] * tau / sensors.boom_counts_horizontal
    pitch = ticks["boom_vertical"] * tau / sensors.boom_counts_vertical
    channels = {
        "step": ticks["step"],
        "travel": sensors.boom_length * yaw,
        "height": sensors.pivot_height + sensors.boom_length * np.sin(pitch),
        "alpha_1": ticks["alpha_1"],
        "alpha_2": ticks["alpha_2"],
        "force": ticks["contact_force"],
    }
    # rounded as in the file, so that the page is the same for a motion from a file and a new one
    return DeploymentMotion(**{name: values.astype(np.float32).astype(float) for name, values in channels.items()})


def kept_motion(record: RunRecord, iteration: int, make: Callable[[int], DeploymentMotion]) -> DeploymentMotion:
    """Reads the motion of a deployment from the run folder, or makes it and writes it there.

    Args:
        record: The run.
        iteration: Number of the deployment.
        make: Computes the motion of a deployment if the folder does not contain the one of these steps and settings.
    """
    path, names = motion_path(record.folder, iteration), [field.name for field in fields(DeploymentMotion)]
    steps, settings = digest(record.steps.of_iteration(iteration)), record.settings and record.settings.text
    origin = sha256(f"sensed {RATE} {iteration} {steps} {settings}".encode()).hexdigest()
    channels = read_motion(path, names, origin)
    if channels is not None:
        return DeploymentMotion(**channels)
    motion = make(iteration)
    write_motion(path, motion.channels, origin)
    return motion
