"""The displayed time of a deployment; independent of the clock and of the page."""

from collections.abc import Callable
from dataclasses import dataclass

Duration = Callable[[int], float | None]
"""Function from the number of a step to its duration [s]; None while that is not known."""


@dataclass
class Player:
    """Advances step by step to the last existing one; step k is the k-th recorded step of the deployment.

    Attributes:
        step: Number of the step that is drawn; 0 is what came before the first recorded step.
        share: Elapsed fraction of its duration, 0…1.
        playing: Whether the motion is playing.
        speed: Speed relative to real time.
        follow: Whether to continue with the newest step after each one, and skip the steps between.
        last: Step after which the player pauses; None to continue.
    """

    step: int = 0
    share: float = 0.0
    playing: bool = True
    speed: float = 1.0
    follow: bool = False
    last: int | None = None

    def show(self, step: int) -> None:
        """Shows a step from its start and stops following."""
        self.step = max(0, step)
        self.share = 0.0
        self.follow = False
        self.last = None

    def toggle(self) -> None:
        """Pauses or resumes the motion."""
        self.playing = not self.playing
        self.last = None

    def one_step(self, count: int) -> None:
        """Plays one step to its end: the present one or, if it has ended, the next."""
        if self.share >= 1.0 and self.step + 1 < count:
            self.step = self.step + 1
            self.share = 0.0
        self.playing = True
        self.follow = False
        self.last = self.step

    def advance(self, elapsed: float, count: int, duration: Duration) -> None:
        """Advances by a time [s], as far as the `count` steps are known."""
        remaining = elapsed * self.speed if self.playing else 0.0
        while remaining > 0 and self.step < count and (length := duration(self.step)) is not None:
            used = min(remaining, (1.0 - self.share) * length)
            self.share = min(1.0, self.share + used / length) if length > 0 else 1.0
            remaining -= used
            if self.share < 1.0 - 1e-12:
                return
            self.share = 1.0
            if self.step == self.last:
                self.playing = False
                self.last = None
            if not self.playing or self.step + 1 >= count:
                return
            if duration(self.step + 1) is None:
                return
            self.step = count - 1 if self.follow else self.step + 1
            self.share = 0.0
