"""The displayed time of a deployment; independent of the clock and of the page."""

from collections.abc import Callable
from dataclasses import dataclass

MOST_SPEED = 16.0
"""Highest speed, relative to real time."""

Duration = Callable[[int], float | None]
"""Function from the number of a hop to its duration [s]; None while that is not known."""


@dataclass
class Player:
    """Advances hop by hop to the last existing hop.

    Hop 0 is the hop after the release, hop k the k-th recorded step of the deployment.

    Attributes:
        hop: Number of the hop that is drawn.
        share: Elapsed fraction of its duration, 0…1.
        playing: Whether the motion is playing.
        speed: Speed relative to real time.
        follow: Whether to continue with the newest hop after each one, and skip the hops between.
        last: Hop after which the player pauses; None to continue.
    """

    hop: int = 0
    share: float = 0.0
    playing: bool = True
    speed: float = 1.0
    follow: bool = False
    last: int | None = None

    def show(self, hop: int) -> None:
        """Shows a hop from its start and stops following."""
        self.hop, self.share, self.follow, self.last = max(0, hop), 0.0, False, None

    def toggle(self) -> None:
        """Pauses or resumes the motion."""
        self.playing, self.last = not self.playing, None

    def one_step(self, count: int) -> None:
        """Plays one hop to its end: the present one or, if it has ended, the next."""
        if self.share >= 1.0 and self.hop + 1 < count:
            self.hop, self.share = self.hop + 1, 0.0
        self.playing, self.follow, self.last = True, False, self.hop

    def advance(self, elapsed: float, count: int, duration: Duration) -> None:
        """Advances by a time [s], as far as the `count` hops are known."""
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
