"""A rig whose motors get no torque, whoever asks: to measure, to calibrate, to try everything else."""

from ctypes import c_longlong
from dataclasses import dataclass, field
from multiprocessing import RawValue
from typing import Any

from stepgap.rigs.limits import RigLimits
from stepgap.rigs.rig import Health, Reading, Rig, SensorModel, Torques


@dataclass(frozen=True)
class FrameCount:
    """Counts lost frames in the process that has the rig, for the one that started that process."""

    memory: Any = field(default_factory=lambda: RawValue(c_longlong, 0))

    @property
    def lost(self) -> int:
        """Frames so far."""
        return self.memory.value

    def count(self) -> None:
        """One more."""
        self.memory.value += 1


class LimpRig(Rig):
    """Reads a rig and writes it zero torque, within limits of its own.

    Args:
        rig: What is read.
        limits: What stops it: lost frames and drives that fail, but neither pose nor speed of the robot.
        frames: Counts the lost frames.
    """

    def __init__(self, rig: Rig, limits: RigLimits, frames: FrameCount):
        self._rig, self._limits, self._frames = rig, limits, frames

    @property
    def sensor_model(self) -> SensorModel:
        """The rig's."""
        return self._rig.sensor_model

    @property
    def limits(self) -> RigLimits:
        """As given."""
        return self._limits

    @property
    def health(self) -> Health:
        """The rig's."""
        return self._rig.health

    def connect(self) -> None:
        """As the rig does."""
        self._rig.connect()

    def read(self) -> Reading:
        """As the rig does."""
        try:
            return self._rig.read()
        finally:
            if self._rig.health.frame_lost:
                self._frames.count()

    def write(self, torques: Torques) -> Torques:
        """Writes zero torque, whatever is asked."""
        return self._rig.write((0.0,) * len(torques))

    def close(self) -> None:
        """As the rig does."""
        self._rig.close()
