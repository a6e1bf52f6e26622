"""The times of ticks: at a fixed interval, which a tick that is late by more than an interval shifts."""

_DELAY_SHARE = 0.02
"""Weight of the last tick in the mean delay of frames; more in the first ticks, whose plain mean it is."""


class TickClock:
    """Time since the start of a deployment.

    Args:
        interval: Time between two ticks [s].

    Attributes:
        time: Time at which the present tick began [s].
        due: Time at which the next tick is due [s].
        slip: Time by which the present tick has shifted all later ones [s].
    """

    def __init__(self, interval: float):
        self.time, self.due, self.slip, self._interval, self._delay = 0.0, 0.0, 0.0, interval, 0.0
        self._share = 1.0

    def begin(self, late: float = 0.0) -> float:
        """Begins a tick that is late [s] and returns its time; a delay above an interval shifts all later ticks."""
        self.time, self.slip = self.due + late, late if late > self._interval else 0.0
        self.due += self.slip + self._interval
        return self.time

    def shift(self, by: float) -> None:
        """Shifts the next tick and all later ones [s]."""
        self.due += by

    def frame_times(self, frames: int, worked: float) -> list[float]:
        """Times of the frames between the present tick and the next one [s]; shape (frames − 1,).

        The frame of a tick is sent when its work is done. The others have the mean of this delay, too, so that all
        frames have equal distances.

        Args:
            frames: Frames per tick, including that of the tick itself.
            worked: Time at which the work of the present tick was done [s].
        """
        begun, distance = self.due - self._interval, self._interval / frames
        delay = min(max(worked - begun, 0.0), distance / 2)
        self._delay += self._share * (delay - self._delay)
        self._share = max(self._share / (1 + self._share), _DELAY_SHARE)
        return [begun + self._delay + number * distance for number in range(1, frames)]
