"""How a deployment moved, thinned for a replay, and the file that keeps it."""

import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from io import BytesIO
from math import tau
from pathlib import Path
from typing import Final

import numpy as np

from stepgap.base.files import write_whole
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.sensors import HopperSensorModel
from stepgap.step import Array

RATE: Final = 100
"""Frames a second."""

LARGEST_FILE: Final = 2**27
"""Largest file of a motion that is read [bytes]."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A hopper on its boom, frame by frame; arrays have shape (F,).

    Attributes:
        step: Number of the step that goes on.
        travel: Distance of the hip along the circle [m].
        height: Of the hip [m].
        alpha_1: Leg angle [rad].
        alpha_2: Half the angle between the top links [rad].
        force: On the foot [N].
    """

    step: Array
    travel: Array
    height: Array
    alpha_1: Array
    alpha_2: Array
    force: Array

    def __post_init__(self) -> None:
        sizes = {getattr(self, field.name).shape for field in fields(self)}
        if len(sizes) != 1 or len(next(iter(sizes))) != 1 or sizes == {(0,)}:
            raise ValueError(f"the channels of a motion must be equally long rows, not of the shapes {sorted(sizes)}")
        if not all(np.isfinite(getattr(self, field.name)).all() for field in fields(self)):
            raise ValueError("a motion must be finite numbers")


@dataclass(frozen=True, eq=False)
class Replay:
    """Motions and what they are motions of.

    Attributes:
        motions: By the number of their deployments.
        robot: Its links and boom.
        pivot_height: Of the boom's pivot above the ground [m].
    """

    motions: Mapping[int, Motion]
    robot: RobotParameters
    pivot_height: float


def sensed_motion(ticks: TickTable, layout: HopperSensorModel) -> Motion:
    """A motion as the sensors saw it.

    Args:
        ticks: With a column `step`, `RATE` of them a second.
        layout: How to read their counts.

    Raises:
        ValueError: There is no tick, or one whose sensors were not read.
    """
    yaw = ticks["boom_horizontal"] * tau / layout.boom_counts_horizontal
    pitch = ticks["boom_vertical"] * tau / layout.boom_counts_vertical
    channels = {
        "step": ticks["step"],
        "travel": layout.boom_length * yaw,
        "height": layout.pivot_height + layout.boom_length * np.sin(pitch),
        "alpha_1": ticks["alpha_1"],
        "alpha_2": ticks["alpha_2"],
        "force": ticks["contact_force"],
    }
    # rounded as it is kept, so that the page is the same however the motion was had
    return Motion(**{name: values.astype(np.float32).astype(float) for name, values in channels.items()})


def write_motion(path: Path, motion: Motion, origin: str) -> None:
    """Keeps a motion with a text that says what it was made from."""
    stream = BytesIO()
    channels = {field.name: getattr(motion, field.name).astype(np.float32) for field in fields(motion)}
    np.savez_compressed(stream, allow_pickle=False, origin=np.array(origin), **channels)
    write_whole(path, stream.getvalue())


def read_motion(path: Path, origin: str) -> Motion | None:
    """The motion kept in a file; None if there is none, if it is damaged, or if it was made from something else."""
    try:
        if path.stat().st_size > LARGEST_FILE:
            return None
        with np.load(BytesIO(path.read_bytes()), allow_pickle=False) as kept:
            if str(kept["origin"]) != origin:
                return None
            return Motion(**{field.name: kept[field.name].astype(float) for field in fields(Motion)})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError):
        return None
