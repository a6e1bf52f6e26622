"""Which step of a deployment is displayed, and how much of it has been played; independent of clock and page."""

from collections.abc import Callable
from dataclasses import dataclass

Duration = Callable[[int], float | None]
"""Function from the number of a step to its duration [s]; None while that is not known."""

ENDED = 1.0 - 1e-12  # Share from which a step is over; a sum of many shares may miss 1 by its rounding


@dataclass
class Player:
    """Plays a deployment step by step, up to the newest step.

    Step 0 is the motion before the first recorded step, and step k the k-th recorded one. So with N recorded steps the
    `count` of the methods is N + 1.

    Attributes:
        step: Number of the step that is drawn.
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
            self.step += 1
            self.share = 0.0
        self.playing = True
        self.follow = False
        self.last = self.step

    def advance(self, elapsed: float, count: int, duration: Duration) -> None:
        """Advances by a time; the motion waits at the end of a step while the next one is not known.

        Args:
            elapsed: Real time since the last call [s].
            count: Number of steps, that before the first recorded one included.
            duration: Durations of the steps.
        """
        remaining = elapsed * self.speed if self.playing else 0.0
        while remaining > 0 and self.step < count and (length := duration(self.step)) is not None:
            # Play the present step, to its end if the time is long enough.
            played = min(remaining, (1.0 - self.share) * length)
            remaining -= played
            self.share = min(1.0, self.share + played / length) if length > 0 else 1.0
            if self.share < ENDED:
                return
            self.share = 1.0
            # Pause after the step that was to be the last one.
            if self.step == self.last:
                self.playing = False
                self.last = None
                return
            # Begin the next step if there is one whose motion is known.
            if self.step + 1 >= count or duration(self.step + 1) is None:
                return
            self.step = count - 1 if self.follow else self.step + 1
            self.share = 0.0
