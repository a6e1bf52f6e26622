"""What the real-time process and the one that learns tell each other, in shared memory; neither waits for the other.

Every field is 8 bytes at a multiple of 8, which processors write in one piece. A message has a number that is written
last and read twice, so that half a message is never taken for one. That relies on stores being seen in their order, as
on x86-64; the interpreter's own work between two of them makes it hold on ARM in practice.
"""

from enum import IntEnum
from math import nan
from multiprocessing.shared_memory import SharedMemory
from typing import NamedTuple, Self

from stepgap.plants.realtime.states import RigState
from stepgap.plants.ticks.tick_ring import attached_memory, created_memory
from stepgap.step import StepStatus

LONGEST_TEXT = 512
"""Bytes of a fault's words."""


class Field(IntEnum):
    """Places of the fields, in words of 8 bytes."""

    REQUEST = 0
    EMERGENCY_STOP = 1
    COMMAND_NUMBER = 2
    FX = 3
    FY = 4
    STATE = 5
    HOP_NUMBER = 6
    SPEED = 7
    HEIGHT = 8
    APPLIED_FX = 9
    APPLIED_FY = 10
    YAW = 11
    REASON = 12
    TICKS = 13
    MISSED_TICKS = 14
    WORST_LATENESS = 15
    TEXT_LENGTH = 16
    TEXT = 17


class Request(IntEnum):
    """What a person wants."""

    NOTHING = 0
    HOP = 1
    STOP = 2


class FinishedHop(NamedTuple):
    """How a hop ended.

    Attributes:
        number: From 0, the hop that begins when the robot is let go.
        speed: At the apex [m/s]; NaN of a hop that failed.
        height: At the apex [m].
        applied_fx: Forward command force that really acted [N].
        applied_fy: Upward command force that really acted [N].
        yaw: Of the robot at the apex [rad]; NaN of a hop that failed.
        status: OK, or why there is no apex.
    """

    number: int
    speed: float
    height: float
    applied_fx: float
    applied_fy: float
    yaw: float
    status: StepStatus

    @classmethod
    def stopped(cls, number: int) -> Self:
        """A hop that was stopped before its apex."""
        return cls(number, nan, nan, 0.0, 0.0, nan, StepStatus.STOPPED)


class Board:
    """Shared memory of a real-time process and the process that started it.

    Args:
        memory: The block; `create` and `attach` get it.
    """

    def __init__(self, memory: SharedMemory):
        assert memory.buf is not None  # until it is closed
        self._memory = memory
        self._words = memory.buf[: 8 * Field.TEXT].cast("q")
        self._numbers = memory.buf[: 8 * Field.TEXT].cast("d")
        self._text = memory.buf[8 * Field.TEXT :][:LONGEST_TEXT]

    @classmethod
    def create(cls) -> Self:
        """A new board, everything zero: no request, OFF, no command."""
        board = cls(created_memory(8 * Field.TEXT + LONGEST_TEXT))
        board._words[Field.COMMAND_NUMBER] = board._words[Field.HOP_NUMBER] = -1
        return board

    @classmethod
    def attach(cls, name: str) -> Self:
        """The board that another process created."""
        return cls(attached_memory(name))

    @property
    def name(self) -> str:
        """By which another process attaches."""
        return self._memory.name

    @property
    def request(self) -> Request:
        """What a person wants."""
        return Request(self._words[Field.REQUEST])

    @request.setter
    def request(self, request: Request) -> None:
        self._words[Field.REQUEST] = request

    @property
    def emergency_stop(self) -> bool:
        """Whether somebody asked for the software stop; it is for good."""
        return self._words[Field.EMERGENCY_STOP] != 0

    def stop_at_once(self) -> None:
        """The software stop: torque off at the next tick. Only a contactor or STO is an emergency stop."""
        self._words[Field.EMERGENCY_STOP] = 1

    def post_command(self, number: int, fx: float, fy: float) -> None:
        """The command force of a hop [N]."""
        self._words[Field.COMMAND_NUMBER] = -1
        self._numbers[Field.FX], self._numbers[Field.FY] = fx, fy
        self._words[Field.COMMAND_NUMBER] = number

    def command(self, number: int) -> tuple[float, float] | None:
        """The command force of a hop [N], if it has been posted."""
        words, numbers = self._words, self._numbers
        if words[Field.COMMAND_NUMBER] != number:
            return None
        command = numbers[Field.FX], numbers[Field.FY]
        return command if words[Field.COMMAND_NUMBER] == number else None

    @property
    def state(self) -> RigState:
        """Where the real-time process is."""
        return RigState(self._words[Field.STATE])

    @state.setter
    def state(self, state: RigState) -> None:
        self._words[Field.STATE] = state

    def post_hop(self, hop: FinishedHop) -> None:
        """How a hop ended."""
        self._words[Field.HOP_NUMBER] = -1
        self._numbers[Field.SPEED], self._numbers[Field.HEIGHT] = hop.speed, hop.height
        self._numbers[Field.APPLIED_FX], self._numbers[Field.APPLIED_FY] = hop.applied_fx, hop.applied_fy
        self._numbers[Field.YAW] = hop.yaw
        self._words[Field.REASON] = hop.status
        self._words[Field.HOP_NUMBER] = hop.number

    def hop(self, number: int) -> FinishedHop | None:
        """How a hop ended, once it has, until the next one has."""
        words, numbers = self._words, self._numbers
        if words[Field.HOP_NUMBER] != number:
            return None
        speed, height, applied_fx, applied_fy, yaw = numbers[Field.SPEED : Field.REASON].tolist()
        found = FinishedHop(number, speed, height, applied_fx, applied_fy, yaw, StepStatus(words[Field.REASON]))
        return found if words[Field.HOP_NUMBER] == number else None

    def count_tick(self, late: float, missed: int) -> None:
        """Counts a tick, by how much it began late [s], and the ticks that were missed for it."""
        words, numbers = self._words, self._numbers
        words[Field.TICKS] += 1
        words[Field.MISSED_TICKS] += missed
        if late > numbers[Field.WORST_LATENESS]:
            numbers[Field.WORST_LATENESS] = late

    @property
    def ticks(self) -> int:
        """Ticks so far."""
        return self._words[Field.TICKS]

    @property
    def missed_ticks(self) -> int:
        """Ticks that could not be made in time."""
        return self._words[Field.MISSED_TICKS]

    @property
    def worst_lateness(self) -> float:
        """Largest delay of a tick's beginning [s]."""
        return self._numbers[Field.WORST_LATENESS]

    @property
    def words(self) -> str:
        """What the real-time process has to say of a fault or a refusal."""
        return bytes(self._text[: self._words[Field.TEXT_LENGTH]]).decode("utf-8", "replace")

    @words.setter
    def words(self, words: str) -> None:
        encoded = words.encode("utf-8", "replace")[:LONGEST_TEXT]
        self._text[: len(encoded)] = encoded
        self._words[Field.TEXT_LENGTH] = len(encoded)

    def close(self) -> None:
        """Lets go of the memory."""
        for view in (self._words, self._numbers, self._text):
            view.release()
        self._memory.close()

    def unlink(self) -> None:
        """Takes the memory away; for the process that created it, after `close`."""
        self._memory.unlink()
