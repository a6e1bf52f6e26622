"""The twin: a MuJoCo stand-in for the real robot, apart from the physics model by a declared `RealityGap`."""

from stepgap.rigs.twin.model import GroundProfile
from stepgap.rigs.twin.reality_gap import RealityGap
from stepgap.rigs.twin.twin import TrueState, Twin

__all__ = ["GroundProfile", "RealityGap", "TrueState", "Twin"]
