"""A rig whose motors get no torque, whatever is commanded: for measurements, calibration and trials."""

from collections.abc import Mapping
from ctypes import c_longlong
from dataclasses import dataclass, field
from multiprocessing import RawValue
from typing import Any

from stepgap.rigs.limits import RigLimits
from stepgap.rigs.rig import ClockLimits, Finding, Health, Reading, Rig, SensorModel, Torques


@dataclass(frozen=True)
class FrameCount:
    """Counts lost frames in the process of the rig, for the process that started it."""

    memory: Any = field(default_factory=lambda: RawValue(c_longlong, 0))

    @property
    def lost(self) -> int:
        """Number of lost frames so far."""
        return self.memory.value

    def count(self) -> None:
        """Counts one more lost frame."""
        self.memory.value += 1


class LimpRig(Rig):
    """Reads a rig and always writes zero torque.

    Args:
        rig: The rig to read.
        limits: Limits that stop it: those of lost frames, but neither those of pose nor of speed.
        frames: Counts the lost frames.
    """

    def __init__(self, rig: Rig, limits: RigLimits, frames: FrameCount):
        self._rig, self._limits, self._frames = rig, limits, frames

    @property
    def sensor_model(self) -> SensorModel:
        """Sensor model of the rig."""
        return self._rig.sensor_model

    @property
    def limits(self) -> RigLimits:
        """Limits as given."""
        return self._limits

    @property
    def health(self) -> Health:
        """Health of the rig."""
        return self._rig.health

    @property
    def diagnostic_units(self) -> Mapping[str, str]:
        """Those of the rig."""
        return self._rig.diagnostic_units

    @property
    def diagnostics(self) -> tuple[float, ...]:
        """Those of the rig."""
        return self._rig.diagnostics

    @property
    def diagnostic_ranges(self) -> Mapping[str, tuple[float, float]]:
        """Those of the rig."""
        return self._rig.diagnostic_ranges

    @property
    def diagnostic_names(self) -> Mapping[str, Mapping[int, str]]:
        """Those of the rig."""
        return self._rig.diagnostic_names

    @property
    def warning(self) -> str:
        """That of the rig, after which a limp robot is switched off."""
        return self._rig.warning

    @property
    def clock_limits(self) -> ClockLimits | None:
        """Those of the rig."""
        return self._rig.clock_limits

    @property
    def remarks(self) -> tuple[str, ...]:
        """Those of the rig."""
        return self._rig.remarks

    def findings(self) -> tuple[Finding, ...]:
        """Those of the rig."""
        return self._rig.findings()

    def clock_correction(self, slip: float = 0.0) -> float:
        """That of the rig."""
        return self._rig.clock_correction(slip)

    def connect(self) -> None:
        """Connects the rig."""
        self._rig.connect()

    def read(self) -> Reading:
        """Reads the rig and counts a lost frame."""
        try:
            return self._rig.read()
        finally:
            if self._rig.health.frame_lost:
                self._frames.count()

    def write(self, torques: Torques) -> Torques:
        """Writes zero torque instead of the given torques."""
        return self._rig.write((0.0,) * len(torques))

    def close(self) -> None:
        """Closes the rig."""
        self._rig.close()
