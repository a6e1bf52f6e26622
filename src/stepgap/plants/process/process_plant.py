"""A plant whose steps another program executes."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import final

import numpy as np

from stepgap.base.ranges import require
from stepgap.plants.plant import Plant
from stepgap.plants.process.line_channel import LineChannel
from stepgap.plants.process.messages import (
    START,
    STOP,
    Answer,
    ProcessFault,
    check_ready,
    hello,
    read_answer,
    read_start,
    step,
)
from stepgap.step import Array, StepRecord, StepSpace, StepStatus


@dataclass(frozen=True)
class Timeouts:
    """Longest times to wait for the program [s].

    Attributes:
        ready: Until it is ready.
        start: Until the robot is at its first section.
        step: Until a step is finished.
        stop: Until the robot is at rest and the program has ended.

    Raises:
        ValueError: A time is not positive.
    """

    ready: float = 10.0
    start: float = 60.0
    step: float = 10.0
    stop: float = 5.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require(0 < value < 1e6, name, value, "be a positive number of seconds")


@final
class ProcessPlant(Plant):
    """Executes steps by exchanging lines of JSON with a program (`messages`), which runs for one deployment.

    If the program ends, answers too late or gives an invalid answer, the step is recorded as stopped, and `fault` has
    the reason.

    Args:
        connect: Starts the program or connects to it, such as `lambda: Child(["./robot"])`.
        space: Names, units and ranges of state and command.
        timeouts: Longest times to wait.
    """

    def __init__(
        self,
        connect: Callable[[], LineChannel],
        space: StepSpace,
        timeouts: Timeouts = Timeouts(),
    ):
        self._connect, self._space, self._timeouts = connect, space, timeouts
        self._channel: LineChannel | None = None
        self._state = np.full(len(space.state), np.nan)
        self._step, self._fault = 0, ""

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self._space

    @property
    def fault(self) -> str:
        """Why the program executes no further step; empty if it did not fail."""
        return self._fault

    def start(self) -> Array:
        """Starts the program and asks for the state at the first section.

        Raises:
            ProcessFault: The program cannot be started, has other names or units, or does not answer.
        """
        self._channel = channel = self._connect()
        channel.send(hello(self._space))
        check_ready(channel.receive(self._timeouts.ready), self._space)
        channel.send(START)
        self._state = read_start(channel.receive(self._timeouts.start), self._space)
        self._step = 0
        return self._state

    def take_step(self, command: Array) -> StepRecord:
        """Sends the command, within its bounds, and waits for the next state."""
        state, command, self._step = self._state, np.asarray(command, float), self._step + 1
        within = np.clip(command, self._space.command_lower, self._space.command_upper)
        nowhere = np.full(len(state), np.nan)
        if not np.isfinite(within).all():
            return StepRecord(state, command, np.zeros_like(command), nowhere, StepStatus.INVALID)
        try:
            answer = self._exchange(within)
        except ProcessFault as fault:
            self._fault = str(fault)
            self.stop()
            return StepRecord(state, command, within, nowhere, StepStatus.STOPPED, requested=within)
        self._state = answer.next_state
        return StepRecord(state, command, answer.applied, self._state, answer.status, answer.context, within)

    def stop(self) -> None:
        """Asks the program to bring the robot to rest, and waits until it has ended."""
        if self._channel is None:
            return
        channel, self._channel = self._channel, None
        try:
            with suppress(ProcessFault):  # it has ended already
                channel.send(STOP)
        finally:
            channel.close(self._timeouts.stop)

    def _exchange(self, command: Array) -> Answer:
        if self._channel is None:
            raise ProcessFault("the program is not running; call start first")
        self._channel.check_quiet()
        self._channel.send(step(self._step, command, self._space))
        line = self._channel.receive(self._timeouts.step)
        return read_answer(line, self._step, command, self._space)
