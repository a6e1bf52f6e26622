"""Torque of a drive: what it reports against what was commanded, whatever the bus."""

from collections import deque

MOST_WRONG = 3
"""Number of readings in a row with a wrong torque, after which the drive is at fault."""

TORQUE_SHARE = 0.15
"""Part of the largest command by which a torque may differ, in addition to the tolerance: the accuracy of a drive."""


class TorqueWatch:
    """Compares the torque of a drive with the commands of the last moments.

    A drive follows its commands after a delay and with a lag, so its torque lies between the least and the largest
    command of that time. A drive that runs away, has the wrong sign, gives nothing or keeps its torque leaves this
    range as soon as the commands do.

    Args:
        tolerance: Distance from that range that is allowed, in the unit of the commands.
        readings: Number of readings over which delay and lag extend.
    """

    def __init__(self, tolerance: float, readings: int):
        self._tolerance, self._sent = tolerance, deque[float](maxlen=max(2, readings))
        self._wrong, self.actual = 0, 0.0

    def restart(self) -> None:
        """Forgets all commands, as before torque is enabled."""
        self._sent.clear()
        self._wrong = 0

    def command(self, torque: float) -> None:
        """Adds the command that was sent last; before it, there was no torque."""
        if not self._sent:
            self._sent.append(0.0)
        self._sent.append(torque)

    @property
    def changed(self) -> bool:
        """Whether the commands of that time differ by more than the tolerance."""
        return bool(self._sent) and max(self._sent) - min(self._sent) > self._tolerance

    def reading(self, actual: float) -> bool:
        """Takes a reading; returns whether the torque has been wrong for `MOST_WRONG` readings in a row."""
        self.actual = actual
        if not self._sent:
            return False
        least, most = min(self._sent), max(self._sent)
        allowed = self._tolerance + TORQUE_SHARE * max(-least, most)
        self._wrong = self._wrong + 1 if not least - allowed <= actual <= most + allowed else 0
        return self._wrong >= MOST_WRONG

    @property
    def commanded(self) -> str:
        """The commands of that time, for messages."""
        least, most = min(self._sent), max(self._sent)
        return f"{least:.4g}" if least == most else f"{least:.4g} to {most:.4g}"
