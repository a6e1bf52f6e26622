"""Messages between the real-time process and the learning process, in shared memory; neither waits for the other.

Every field is 8 bytes at a multiple of 8, which processors write atomically. A finished step has a number that is
written last and read twice. A command and a touchdown, of which a step may have several, have a version that is odd
while they are written. So an incomplete one is never used. This requires that stores become visible in their order, as
on x86-64; on ARM it holds in practice, since the interpreter executes much code between two stores.
"""

from collections.abc import Callable, Sequence
from enum import IntEnum
from itertools import accumulate, pairwise
from multiprocessing.shared_memory import SharedMemory
from typing import Generic, NamedTuple, Self, TypeVar

import numpy as np

from stepgap.plants.tick_control import FinishedStep
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_ring import attached_memory, created_memory
from stepgap.step import StepStatus

LONGEST_MESSAGE = 2048  # Largest length of a message [bytes]
LONGEST_EVIDENCE = 32  # Largest number of numbers that the control of the next deployment begins with


class Field(IntEnum):
    """Offsets of the fields, in words of 8 bytes; after them follow the vectors of the robot, and the message."""

    STATES = 0
    COMMANDS = 1
    REQUEST = 2
    EMERGENCY_STOP = 3
    COMMAND_NUMBER = 4
    RIG_STATE = 5
    STEP_NUMBER = 6
    STATUS = 7
    TICKS = 8
    MISSED_TICKS = 9
    PRESSES = 10
    MESSAGE_LENGTH = 11
    CONTEXT = 12
    TOUCHDOWN_NUMBER = 13
    COMMAND_VERSION = 14
    TOUCHDOWN_VERSION = 15
    LOST_FRAMES = 16
    EVIDENCE_LENGTH = 17


class Request(IntEnum):
    """Request of a person to the real-time process."""

    NOTHING = 0
    START = 1
    STOP = 2


class StepEnd(NamedTuple):
    """How a step ended.

    Attributes:
        result: Its result.
        status: OK, or the reason why there is no next state.
    """

    result: FinishedStep
    status: StepStatus


Content = TypeVar("Content", bound=int)


class _Word(Generic[Content]):
    """A word of the board as an attribute."""

    def __init__(self, field: Field, kind: Callable[[int], Content]):
        self._field = field
        self._kind = kind

    def __get__(self, board: "Board", owner: object) -> Content:
        return self._kind(board._words[self._field])

    def __set__(self, board: "Board", value: Content) -> None:
        board._words[self._field] = value


class Board:
    """Shared memory of a real-time process and the process that started it.

    Args:
        memory: The shared memory, which `create` and `attach` open.
        states: Number of state coordinates of the robot, n.
        commands: Number of command coordinates of the robot, m.
        context: Number of quantities of its context.

    Attributes:
        request: The latest request of a person.
        emergency_stop: Whether the software stop was requested; the request cannot be revoked.
        presses: Number of times that the key came by which a person consents to torque, as long as it is held.
        state: State of the real-time process.
        ticks: Number of ticks so far.
        missed_ticks: Number of missed ticks so far.
        lost_frames: Number of frames of the bus that were lost so far.
    """

    request = _Word(Field.REQUEST, Request)
    emergency_stop = _Word(Field.EMERGENCY_STOP, bool)
    presses = _Word(Field.PRESSES, int)
    state = _Word(Field.RIG_STATE, RigState)
    ticks = _Word(Field.TICKS, int)
    missed_ticks = _Word(Field.MISSED_TICKS, int)
    lost_frames = _Word(Field.LOST_FRAMES, int)

    def __init__(self, memory: SharedMemory, states: int, commands: int, context: int):
        assert memory.buf is not None  # until it is closed
        self._memory = memory
        ends = accumulate(
            (commands, states, commands, commands, context, context, LONGEST_EVIDENCE), initial=len(Field)
        )
        parts = [slice(*pair) for pair in pairwise(ends)]
        self._command, self._state, self._acted, self._lost, self._context, self._found, self._evidence = parts
        length = self._evidence.stop
        self._words = memory.buf[: 8 * length].cast("q")
        self._numbers = memory.buf[: 8 * length].cast("d")
        self._message = memory.buf[8 * length :][:LONGEST_MESSAGE]

    @classmethod
    def create(cls, states: int, commands: int, context: int) -> Self:
        """Creates a board, everything zero: no request, OFF, no command; arguments as of the class."""
        length = len(Field) + states + 3 * commands + 2 * context + LONGEST_EVIDENCE
        board = cls(created_memory(8 * length + LONGEST_MESSAGE), states, commands, context)
        board._words[Field.STATES] = states
        board._words[Field.COMMANDS] = commands
        board._words[Field.CONTEXT] = context
        for number in (Field.COMMAND_NUMBER, Field.STEP_NUMBER, Field.TOUCHDOWN_NUMBER):
            board._words[number] = -1
        return board

    @classmethod
    def attach(cls, name: str) -> Self:
        """Opens the board that another process created."""
        memory = attached_memory(name)
        assert memory.buf is not None  # until it is closed
        with memory.buf[: 8 * len(Field)].cast("q") as words:
            sizes = words[Field.STATES], words[Field.COMMANDS], words[Field.CONTEXT]
        return cls(memory, *sizes)

    @property
    def name(self) -> str:
        """Name by which another process attaches."""
        return self._memory.name

    def stop_at_once(self) -> None:
        """Requests the software stop: torque off at the next tick. Only a contactor or STO is an emergency stop."""
        self._words[Field.EMERGENCY_STOP] = 1

    def post_command(self, number: int, command: Sequence[float]) -> None:
        """Posts the command of a step, m numbers; it replaces the one that was posted before."""
        self._post(Field.COMMAND_NUMBER, Field.COMMAND_VERSION, self._command, number, command)

    def command(self, number: int) -> tuple[float, ...] | None:
        """The command of a step, m numbers; None if it has not been posted."""
        return self._posted(Field.COMMAND_NUMBER, Field.COMMAND_VERSION, self._command, number)

    def post_touchdown(self, number: int, context: Sequence[float]) -> None:
        """Posts what the touchdown of a step has found, in the order of the robot's context."""
        self._post(Field.TOUCHDOWN_NUMBER, Field.TOUCHDOWN_VERSION, self._found, number, context)

    def touchdown(self, number: int) -> tuple[float, ...] | None:
        """What the touchdown of a step has found; None before it and after that of the next one."""
        return self._posted(Field.TOUCHDOWN_NUMBER, Field.TOUCHDOWN_VERSION, self._found, number)

    def _post(self, number_at: Field, version_at: Field, part: slice, number: int, values: Sequence[float]) -> None:
        self._words[version_at] += 1
        self._write(part, values)
        self._words[number_at] = number
        self._words[version_at] += 1

    def _posted(self, number_at: Field, version_at: Field, part: slice, number: int) -> tuple[float, ...] | None:
        words = self._words
        version = words[version_at]
        if version % 2 or words[number_at] != number:
            return None
        values = tuple(self._numbers[part].tolist())
        return values if words[version_at] == version else None

    def post_step(self, number: int, end: StepEnd) -> None:
        """Posts how a step ended; the number of the one that begins when the robot is released is 0."""
        step = end.result
        self._words[Field.STEP_NUMBER] = -1
        for part, values in ((self._state, step.state), (self._acted, step.command), (self._lost, step.lost)):
            self._write(part, values.tolist())
        self._write(self._context, step.context or (np.nan,) * self._words[Field.CONTEXT])
        self._words[Field.STATUS] = end.status
        self._words[Field.STEP_NUMBER] = number

    def finished(self, number: int) -> StepEnd | None:
        """How a step ended; None before its end and after the end of the next one."""
        words = self._words
        numbers = self._numbers
        if words[Field.STEP_NUMBER] != number:
            return None
        state, command, lost = (np.array(numbers[part].tolist()) for part in (self._state, self._acted, self._lost))
        context = tuple(numbers[self._context].tolist())
        end = StepEnd(FinishedStep(state, command, lost, context), StepStatus(words[Field.STATUS]))
        return end if words[Field.STEP_NUMBER] == number else None

    @property
    def evidence(self) -> tuple[float, ...]:
        """Evidence against the sensors after the last step, or before the first one: `TickControl.evidence`.

        It is complete once the process that posts it has ended.
        """
        return tuple(self._numbers[self._evidence].tolist()[: self._words[Field.EVIDENCE_LENGTH]])

    @evidence.setter
    def evidence(self, evidence: Sequence[float]) -> None:
        start = self._evidence.start
        self._write(slice(start, start + len(evidence)), evidence)
        self._words[Field.EVIDENCE_LENGTH] = len(evidence)

    def _write(self, part: slice, values: Sequence[float]) -> None:
        for word, value in zip(range(part.start, part.stop), values, strict=True):
            self._numbers[word] = value

    def count_tick(self, missed: int) -> None:
        """Counts a tick, and the ticks that were missed before it."""
        self._words[Field.TICKS] += 1
        self._words[Field.MISSED_TICKS] += missed

    @property
    def message(self) -> str:
        """Message of the real-time process about a fault or a refused request."""
        return bytes(self._message[: self._words[Field.MESSAGE_LENGTH]]).decode("utf-8", "replace")

    @message.setter
    def message(self, message: str) -> None:
        encoded = message.encode("utf-8", "replace")[:LONGEST_MESSAGE]
        self._message[: len(encoded)] = encoded
        self._words[Field.MESSAGE_LENGTH] = len(encoded)

    def close(self) -> None:
        """Closes the memory in this process."""
        for view in (self._words, self._numbers, self._message):
            view.release()
        self._memory.close()

    def unlink(self) -> None:
        """Frees the memory; for the process that created it, after `close`."""
        self._memory.unlink()
