"""A rig whose ticks are called one by one, in contrast to the compiled run of the twin."""

from stepgap.rigs.wrapped_rig import WrappedRig
from stepgap.robots.hopper.tick.sensors import HopperReading
from stepgap.robots.hopper.twin.twin import Twin


class SingleTicks(WrappedRig):
    """A twin without its compiled run.

    Attributes:
        wrong: Sensor values that replace those of the twin, by name.
    """

    def __init__(self, twin: Twin):
        super().__init__(twin)
        self._twin = twin
        self.wrong = dict[str, float]()

    def read(self) -> HopperReading:
        return self._twin.read()._replace(**self.wrong)
