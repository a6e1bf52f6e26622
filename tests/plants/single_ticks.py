"""A rig whose ticks are called one by one, in contrast to the compiled run of the twin."""

from stepgap.rigs.rig import Rig, Torques
from stepgap.robots.hopper.tick.sensors import HopperReading, HopperSensorModel
from stepgap.robots.hopper.twin.twin import Twin


class SingleTicks(Rig):
    """A twin without its compiled run.

    Attributes:
        wrong: Sensor values that replace those of the twin, by name.
    """

    def __init__(self, twin: Twin):
        self._twin, self.wrong = twin, dict[str, float]()

    @property
    def sensor_model(self) -> HopperSensorModel:
        return self._twin.sensor_model

    @property
    def truth(self) -> tuple[float, ...]:
        return self._twin.truth

    @property
    def released(self) -> tuple[float, ...]:
        return self._twin.released

    def connect(self) -> None:
        self._twin.connect()

    def read(self) -> HopperReading:
        return self._twin.read()._replace(**self.wrong)

    def write(self, torques: Torques) -> Torques:
        return self._twin.write(torques)

    def close(self) -> None:
        self._twin.close()
