"""Motion files `replay/deployment_K.npz`: the motion of a robot in a deployment."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from io import BytesIO
from pathlib import Path
from typing import Final

import numpy as np

from stepgap.base.files import own_folder, read_bounded, write_whole
from stepgap.base.numpy_file import arrays_in
from stepgap.robots.scene import GroundPieces, Motion, Scene

INTERVAL: Final = 0.01
"""Time between two frames of a replay [s]; the nearest multiple of the time between two ticks is used."""

LARGEST_MOTION: Final = 2**27  # Largest motion that is read, compressed or not [bytes]
ORIGIN: Final = "origin"  # Entry that identifies the data from which a motion was computed


@dataclass(frozen=True, eq=False)
class Replay:
    """Motions of a robot in several deployments.

    Attributes:
        motions: Motions by number of the deployment.
        scene: What is drawn.
        grounds: Grounds by number of the deployment, where they are uneven.
    """

    motions: Mapping[int, Motion]
    scene: Scene
    grounds: Mapping[int, GroundPieces] = field(default_factory=dict)


def motion_path(folder: Path, iteration: int) -> Path:
    """Path of the motion of a deployment; raises InputError if its folder is a link."""
    return own_folder(folder, "replay") / f"deployment_{iteration}.npz"


def write_motion(path: Path, motion: Motion, origin: str) -> Motion:
    """Writes a motion in single precision, and returns the motion that will be read.

    Args:
        path: The file; replaced if it exists.
        motion: The motion.
        origin: Identifies the data from which the motion was computed.
    """
    stream = BytesIO()
    single = {field.name: getattr(motion, field.name).astype(np.float32) for field in fields(Motion)}
    np.savez_compressed(stream, allow_pickle=False, **{ORIGIN: np.array(origin)}, **single)
    write_whole(path, stream.getvalue())
    return Motion(**{name: values.astype(float) for name, values in single.items()})


def read_motion(path: Path, scene: Scene, origin: str) -> Motion | None:
    """Reads a motion; None if there is no file, it is damaged, or it has another scene or origin.

    Args:
        path: The file.
        scene: What is drawn.
        origin: Identifies the data from which the motion must have been computed.
    """
    try:
        kept = arrays_in(read_bounded(path, LARGEST_MOTION), LARGEST_MOTION)
        if str(kept[ORIGIN]) != origin:
            return None
        motion = Motion(**{field.name: kept[field.name].astype(float) for field in fields(Motion)})
    except (OSError, ValueError, KeyError):
        return None
    frames = len(motion.time)
    points = len(scene.points)
    feet = len(scene.feet)
    signals = len(scene.signals)
    shapes = ((frames,), (frames,), (frames, points, 3), (frames, feet), (frames,), (frames, signals))
    return motion if tuple(getattr(motion, field.name).shape for field in fields(Motion)) == shapes else None
