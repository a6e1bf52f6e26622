"""The moment of a deployment that is drawn; knows no clock and no page."""

from collections.abc import Callable
from dataclasses import dataclass

MOST_SPEED = 16.0
"""Fastest, times real time."""

Duration = Callable[[int], float | None]
"""How long a hop takes [s]; None while it is not known yet."""


@dataclass
class Player:
    """Moves on hop by hop as far as there are hops.

    Hop 0 is the hop after the release, hop k the k-th recorded step of the deployment.

    Attributes:
        hop: Number of the hop that is drawn.
        share: Share of its duration that is over, 0…1.
        playing: Whether time is running.
        speed: Times real time.
        follow: Whether the newest hop follows each one, whatever lies between.
        last: Where it stops by itself; None: nowhere.
    """

    hop: int = 0
    share: float = 0.0
    playing: bool = True
    speed: float = 1.0
    follow: bool = False
    last: int | None = None

    def show(self, hop: int) -> None:
        """Shows a hop from its start, without following any longer."""
        self.hop, self.share, self.follow, self.last = max(0, hop), 0.0, False, None

    def toggle(self) -> None:
        """Stops time, or lets it run."""
        self.playing, self.last = not self.playing, None

    def one_step(self, count: int) -> None:
        """Plays one hop to its end: the one under way, or the next if it is over."""
        if self.share >= 1.0 and self.hop + 1 < count:
            self.hop, self.share = self.hop + 1, 0.0
        self.playing, self.follow, self.last = True, False, self.hop

    def advance(self, elapsed: float, count: int, duration: Duration) -> None:
        """Advances the time [s], as far as the `count` hops are known."""
        remaining = elapsed * self.speed if self.playing else 0.0
        while remaining > 0 and self.hop < count and (length := duration(self.hop)) is not None:
            used = min(remaining, (1.0 - self.share) * length)
            self.share = min(1.0, self.share + used / length) if length > 0 else 1.0
            remaining -= used
            if self.share < 1.0 - 1e-12:
                return
            self.share = 1.0
            if self.hop == self.last:
                self.playing, self.last = False, None
            if not self.playing or self.hop + 1 >= count:
                return
            if duration(self.hop + 1) is None:
                return
            self.hop, self.share = (count - 1 if self.follow else self.hop + 1), 0.0
