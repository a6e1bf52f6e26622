"""The robot's motion in a deployment, at the frame rate of the replay."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Final

from stepgap.records.motion_file import motion_path, read_motion, write_motion
from stepgap.records.run_folder import RunRecord
from stepgap.records.steps_csv import digest
from stepgap.robots.scene import Motion, Scene

INTERVAL: Final = 0.01
"""Time between two frames of a replay [s]; the nearest multiple of the time between two ticks is used."""


@dataclass(frozen=True, eq=False)
class Replay:
    """Motions of a robot in several deployments.

    Attributes:
        motions: Motions by number of the deployment.
        scene: What is drawn.
    """

    motions: Mapping[int, Motion]
    scene: Scene


def kept_motion(record: RunRecord, scene: Scene, iteration: int, make: Callable[[int], Motion]) -> Motion:
    """Reads the motion of a deployment from the run folder, or makes it and writes it there.

    Args:
        record: The run.
        scene: What is drawn.
        iteration: Number of the deployment.
        make: Computes the motion of a deployment if the folder does not contain the one of these steps and settings.
    """
    path = motion_path(record.folder, iteration)
    steps, settings = digest(record.steps.of_iteration(iteration)), record.settings and record.settings.text
    origin = sha256(f"measured {INTERVAL} {scene} {iteration} {steps} {settings}".encode()).hexdigest()
    motion = read_motion(path, scene, origin)
    if motion is None:
        motion = write_motion(path, make(iteration), origin)
    return motion
