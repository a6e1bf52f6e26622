"""A plant whose steps another program executes."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import final

import numpy as np

from stepgap.base.ranges import require
from stepgap.plants.plant import AtTouchdown, Plant, StepCommands, Touchdown
from stepgap.plants.process.line_channel import LineChannel
from stepgap.plants.process.messages import (
    START,
    STOP,
    Answer,
    ProcessFault,
    ReportedError,
    check_ready,
    hello,
    read_answer,
    read_start,
    read_touchdown,
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

    If the program reports that its robot cannot go on, the step is recorded as stopped, and `fault` has the reason. A
    program that ends, answers too late or gives an invalid answer says nothing of its robot: that is no step.

    Args:
        connect: Starts the program or connects to it, such as `lambda: Child(["./robot"])`.
        space: Names, units and ranges of state and command.
        seconds: Duration of a step, which the program is told [s]; None where steps have no fixed one.
    """

    def __init__(
        self,
        connect: Callable[[], LineChannel],
        space: StepSpace,
        timeouts: Timeouts = Timeouts(),
        seconds: float | None = None,
    ):
        self._seconds = seconds
        self._connect = connect
        self._space = space
        self._timeouts = timeouts
        self._channel: LineChannel | None = None
        self._measured = np.full(len(space.state), np.nan)  # from fixed zeros
        self._context: Mapping[str, float] = {}
        self._step = 0
        self._fault = ""

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self._space

    @property
    def fault(self) -> str:
        """Why the robot takes no further step, as its program reported; empty if it did not."""
        return self._fault

    def start(self) -> Array:
        """Starts the program and asks for the state at the first section.

        Raises:
            ProcessFault: The program cannot be started, has other names or units, or does not answer.
        """
        self._channel = channel = self._connect()
        channel.send(hello(self._space, self._seconds))
        check_ready(channel.receive(self._timeouts.ready), self._space)
        channel.send(START)
        self._measured, self._context = read_start(channel.receive(self._timeouts.start), self._space)
        self._step = 0
        return self._above(self._measured)

    def take_step(self, command: Array) -> StepRecord:
        """Sends the command, within its bounds, and waits for the next state.

        Raises:
            ProcessFault: The program ended, did not answer in time, or gave an invalid answer; it is ended.
        """
        return self.take_replanned_step(command, lambda _: command)

    def take_replanned_step(self, command: Array, at_touchdown: AtTouchdown) -> StepRecord:
        """Sends the command, and another one when the program reports a touchdown; waits for the next state.

        Raises:
            ProcessFault: As `take_step`.
        """
        before = self._measured
        self._step += 1
        commands = StepCommands(self._space, command)
        nowhere = np.full(len(before), np.nan)
        within = commands.within
        if not np.isfinite(within).all():
            state = self._space.onward(self._above(before))
            return StepRecord(state, commands.first, np.zeros_like(within), nowhere, StepStatus.INVALID)

        def chosen(context: dict[str, float]) -> Array:
            self._context = context
            return commands.replace(at_touchdown, Touchdown(self._space.onward(self._above(before)), context))

        try:
            answer = self._exchange(within, chosen)
        except ReportedError as error:
            self._fault = str(error)
            self.stop()
            state = self._space.onward(self._above(before))
            within = commands.within
            return StepRecord(state, commands.acted(within), within, nowhere, StepStatus.STOPPED, requested=within)
        except ProcessFault as fault:
            self.stop()
            remark = "its program failed, which is no fall of the robot"
            raise ProcessFault(f"step {self._step}: {fault}; {remark}") from None
        self._measured = answer.next_state
        self._context = answer.context or self._context
        state = self._space.onward(self._above(before))
        next_state = self._above(answer.next_state)
        command = commands.acted(answer.requested)
        return StepRecord(state, command, answer.applied, next_state, answer.status, answer.context, answer.requested)

    def stop(self) -> None:
        """Asks the program to bring the robot to rest, and waits until it has ended."""
        if self._channel is None:
            return
        channel = self._channel
        self._channel = None
        try:
            with suppress(ProcessFault):  # it has ended already
                channel.send(STOP)
        finally:
            channel.close(self._timeouts.stop)

    def _exchange(self, command: Array, chosen: Callable[[dict[str, float]], Array]) -> Answer:
        """Sends a command, and another one at a touchdown; the answer to the step."""
        if self._channel is None:
            raise ProcessFault("the program is not running; call start first")
        self._channel.check_quiet()
        self._channel.send(step(self._step, command, self._space))
        line = self._channel.receive(self._timeouts.step)
        if (context := read_touchdown(line, self._step, self._space)) is not None:
            command = chosen(context)
            self._channel.send(step(self._step, command, self._space))
            line = self._channel.receive(self._timeouts.step)
        return read_answer(line, self._step, command, self._space)

    def _above(self, state: Array) -> Array:
        """A state with the coordinates that are measured above the last known context; shape (n,)."""
        return self._space.above(state, [self._context.get(name, np.nan) for name in self._space.context_names])
