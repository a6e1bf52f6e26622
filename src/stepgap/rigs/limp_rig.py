"""A rig whose motors get no torque, whoever asks: to measure, to calibrate, to try everything else."""

from ctypes import c_longlong
from dataclasses import dataclass, field
from math import inf
from multiprocessing import RawValue
from typing import Any

from stepgap.rigs.rig import Health, Reading, Rig, RigLayout
from stepgap.robots.hopper.limits import SafetyLimits

MOST_LATE_TICKS = 50
"""Ticks in a row that may be missed where nothing moves; the most that limits can say."""


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
    """Reads a rig and writes it zero torque.

    Neither pose nor speed of the robot stops it, so that people may move the leg, and may do so before the encoders
    have their zeros; nor do late ticks, as far as limits can say that. Lost frames and drives that fail do.

    Args:
        rig: What is read.
        limits: Of that rig, where it has none.
        frames: Counts those that are lost.
    """

    def __init__(self, rig: Rig, limits: SafetyLimits, frames: FrameCount):
        self._rig, self._frames = rig, frames
        limits = rig.limits or limits
        self._limits = SafetyLimits(
            torque=limits.torque,
            joint_speed=inf,
            lost_frames=limits.lost_frames,
            stale_ticks=limits.lost_frames,
            late_ticks=MOST_LATE_TICKS,
            brake_damping=0.0,
            brake_ticks=0,
        )

    @property
    def layout(self) -> RigLayout:
        """The rig's."""
        return self._rig.layout

    @property
    def limits(self) -> SafetyLimits:
        """Such that only the bus stops it."""
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

    def write(self, torque_1: float, torque_2: float) -> tuple[float, float]:  # noqa: ARG002  (what is asked is not done)
        """Writes zero torque."""
        return self._rig.write(0.0, 0.0)

    def close(self) -> None:
        """As the rig does."""
        self._rig.close()
