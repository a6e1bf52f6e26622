"""The correction on the robot: velocity commands and odometry in, corrected commands out.

It needs NumPy and the `StepFilter` of `controller.py`. It never waits, and reads no clock: the caller says the time.
Whenever something is wrong with the odometry, the command is the one that was asked for, and `reason` says why.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

LEAST_SAMPLES = 4  # Samples of a step, of which the mean velocity is taken
LONGEST_SILENCE = 0.45  # Part of a step that may be without a sample


@dataclass(frozen=True)
class FilterSettings:
    """What the correction knows of the robot.

    Attributes:
        seconds: Duration of a step [s].
        limits: Largest commands, forward, to the left and turning, of either sign; shape (3,).
        axes: Which of the three are corrected; the others are passed on.
        stale: Odometry that is older does not count [s].
        frozen: Odometry that repeats the same numbers, which are not zero, for longer does not count [s].
        jump: Largest change of each velocity from one sample to the next; shape (3,).
        again: A changing command is planned for at most once in this time [s].
        zero: Whether the command zero is passed on, for a robot that stands then.
        learns: Whether it goes on learning, as a deployment does.
    """

    seconds: float
    limits: tuple[float, ...]
    axes: tuple[bool, ...] = (True, True, True)
    stale: float = 0.2
    frozen: float = 0.3
    jump: tuple[float, ...] = (math.inf, math.inf, math.inf)
    again: float = 0.1
    zero: bool = False
    learns: bool = True


class VelocityFilter:
    """Corrects velocity commands.

    Args:
        controller: A `StepFilter`.
        settings: What is known of the robot.

    Attributes:
        reason: Why the latest command is not corrected; empty if it is.
        is_on: Whether commands are corrected at all.
    """

    def __init__(self, controller: Any, settings: FilterSettings):
        self._controller = controller
        self._settings = settings
        self._samples: deque[tuple[float, np.ndarray]] = deque()
        self._sent: deque[tuple[float, np.ndarray]] = deque()
        self._fault = ""
        self._faulty_since = -math.inf
        self._same_since = -math.inf
        self._begin = -math.inf
        self._target = np.full(3, np.nan)
        self._start: np.ndarray | None = None
        self._planned = np.zeros(3)
        self._pose: Any = (math.nan, math.nan, math.nan)  # of the latest sample
        self._moved = False  # whether another command than the planned one was sent in this step
        self.reason = "no odometry yet"
        self.is_on = True

    def odometry(self, time: float, velocity: Any, pose: Any = (math.nan, math.nan, math.nan)) -> None:
        """Takes a sample of the velocity in the frame of the robot.

        Args:
            time: Of the sample, by the clock of `command` [s].
            velocity: Forward, to the left [m/s], turning to the left [rad/s].
            pose: Place [m] and heading [rad], from any zero, NaN where they are not measured.
        """
        values = np.asarray(velocity, float)
        if values.shape != (3,) or not np.isfinite(values).all() or not math.isfinite(time):
            self._note(time, "the odometry is no number")
            return
        if not self._samples:
            self._same_since = time
        else:
            last_time, last = self._samples[-1]
            if time <= last_time:
                return  # an old sample; if all are, the odometry becomes stale
            if (np.abs(values - last) > self._settings.jump).any():
                self._note(time, "the odometry jumps")
            if (values != last).any() or not values.any():
                self._same_since = time
        self._samples.append((time, values))
        self._pose = pose
        while self._samples[0][0] < time - 3 * self._settings.seconds:
            self._samples.popleft()

    def command(self, time: float, asked: Any) -> tuple[float, float, float]:
        """The command for the robot, always within the limits.

        Args:
            time: Now [s].
            asked: Velocity that is wanted: forward, to the left, turning to the left.
        """
        limits = np.array(self._settings.limits)
        wanted = np.asarray(asked, float)
        if wanted.shape != (3,) or not np.isfinite(wanted).all():
            self.reason = "the command is no number: the robot is told to stand"
            return self._send(time, np.zeros(3))
        wanted = np.clip(wanted, -limits, limits)
        self.reason = self._why_not(time, wanted)
        if self.reason:
            self._leave_step()
            return self._send(time, wanted)
        if time > self._begin + 2 * self._settings.seconds:
            self._leave_step()  # nobody asked for a while
        changed = (wanted != self._target).any()
        ended = time >= self._begin + self._settings.seconds - 1e-9
        if ended or (changed and time >= self._begin + self._settings.again - 1e-9):
            self._plan(time, wanted, ended and not self._moved)
        if self.reason:
            return self._send(time, wanted)
        # Between two plans the correction of the latest one stays.
        since = wanted - self._target
        self._moved = self._moved or bool(since.any())
        moved = self._planned + since
        sent = np.where(self._settings.axes, moved, wanted)
        return self._send(time, np.clip(sent, -limits, limits))

    def _why_not(self, time: float, wanted: np.ndarray) -> str:
        settings = self._settings
        if not self.is_on:
            return "the correction is turned off"
        if settings.zero and not wanted.any():
            return "the command is zero, at which this robot stands"
        if not self._samples:
            return self._fault or "no odometry yet"
        if time - self._samples[-1][0] > settings.stale:
            return self._fault or f"no odometry for {settings.stale:g} s"
        if time < self._faulty_since + 2 * settings.seconds:
            return self._fault
        self._fault = ""
        if self._samples[-1][0] - self._same_since > settings.frozen:
            return f"the odometry repeats the same numbers for more than {settings.frozen:g} s"
        if self._mean(time) is None:
            return "the odometry has too few samples in a step"
        return ""

    def _plan(self, time: float, wanted: np.ndarray, is_whole: bool) -> None:
        """Ends the present step, and begins another one."""
        state = self._mean(time)
        if self._start is not None:
            start = self._start if is_whole else None  # from a step that was cut short nothing is learned
            part = (time - self._begin) / self._settings.seconds
            how = {"pose": self._pose, "part": part, "learns": self._settings.learns}
            self._controller.update(start, self._planned, state, **how)
        before = self._mean_sent(time)
        target = np.where(self._settings.axes, wanted, np.nan)
        plan = self._controller.plan(state, target, before)
        if plan.status != 0 or not np.isfinite(plan.command).all():
            self.reason = f"no plan is found (status {plan.status})"
            self._leave_step()
            return
        self._begin = time
        self._target = wanted
        self._start = state
        self._moved = False
        self._planned = np.array(plan.command, float)

    def _leave_step(self) -> None:
        if self._start is not None:
            self._controller.forget_way()
            if self._settings.learns:
                self._controller.update(None, self._planned, None)
        self._start = None
        self._begin = -math.inf
        self._target = np.full(3, np.nan)

    def _note(self, time: float, fault: str) -> None:
        self._fault = fault
        if math.isfinite(time):
            self._faulty_since = time

    def _mean(self, end: float) -> np.ndarray | None:
        """Mean velocity of the step before a time; None with too few samples, or a gap."""
        begin = end - self._settings.seconds
        inside = [(time, value) for time, value in self._samples if time >= begin]
        times = np.array([begin, *(time for time, _ in inside), end])
        if len(inside) < LEAST_SAMPLES or np.diff(times).max() > LONGEST_SILENCE * self._settings.seconds:
            return None
        values = np.array([value for _, value in inside])
        samples = np.vstack([values[:1], values, values[-1:]])
        return (samples[1:] + samples[:-1]).T @ np.diff(times) / (2 * self._settings.seconds)

    def _mean_sent(self, end: float) -> np.ndarray | None:
        """Mean of the commands that were sent in the step before a time; None if that is not known."""
        begin = end - self._settings.seconds
        while len(self._sent) > 1 and self._sent[1][0] <= begin:
            self._sent.popleft()
        if not self._sent:
            return None
        times = np.clip([*(time for time, _ in self._sent), end], begin, end)
        widths = np.diff(times)
        if not widths.sum() > 0:
            return self._sent[-1][1]
        return widths @ np.array([value for _, value in self._sent]) / widths.sum()

    def _send(self, time: float, command: np.ndarray) -> tuple[float, float, float]:
        if not self._sent or (self._sent[-1][1] != command).any():
            self._sent.append((time, command))
        while len(self._sent) > 1 and self._sent[1][0] < time - 3 * self._settings.seconds:
            self._sent.popleft()
        forward, left, turning = command.tolist()
        return forward, left, turning
