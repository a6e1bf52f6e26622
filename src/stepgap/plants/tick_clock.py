"""When ticks begin: at a fixed interval, moved on by one that came more than an interval late."""


class TickClock:
    """Time since the start of a deployment.

    Args:
        interval: Between two ticks [s].

    Attributes:
        time: When the present tick began [s].
        due: When the next one is to begin [s].
    """

    def __init__(self, interval: float):
        self.time, self.due, self._interval = 0.0, 0.0, interval

    def begin(self, late: float = 0.0) -> float:
        """Begins a tick that is late [s] and returns its time; more than an interval moves all later ticks."""
        self.time = self.due + late
        self.due = (self.time if late > self._interval else self.due) + self._interval
        return self.time
