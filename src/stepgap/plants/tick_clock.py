"""The times of ticks: at a fixed interval, which a tick that is late by more than an interval shifts."""


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
        self.time, self.due, self.slip, self._interval = 0.0, 0.0, 0.0, interval

    def begin(self, late: float = 0.0) -> float:
        """Begins a tick that is late [s] and returns its time; a delay above an interval shifts all later ticks."""
        self.time, self.slip = self.due + late, late if late > self._interval else 0.0
        self.due += self.slip + self._interval
        return self.time

    def shift(self, by: float) -> None:
        """Shifts the next tick and all later ones [s]."""
        self.due += by
