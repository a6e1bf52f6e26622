"""A rig without hardware whose sensors never change: what the machine itself can do is measured with it."""

from stepgap.rigs.rig import Reading, Rig, RigLayout


class StillRig(Rig):
    """Gives the same reading at every tick and takes any torque.

    Args:
        layout: How to read the counts.
        reading: The counts.
    """

    def __init__(self, layout: RigLayout, reading: Reading):
        self._layout, self._reading = layout, reading

    @property
    def layout(self) -> RigLayout:
        """How to read the counts."""
        return self._layout

    def connect(self) -> None:
        """There is nothing to connect."""

    def read(self) -> Reading:
        """Always the same."""
        return self._reading

    def write(self, torque_1: float, torque_2: float) -> tuple[float, float]:
        """Nothing moves; the torques as asked [N·m]."""
        return torque_1, torque_2

    def close(self) -> None:
        """There is nothing to close."""
