"""Messages between the real-time process and the learning process, in shared memory; neither waits for the other.

Every field is 8 bytes at a multiple of 8, which processors write atomically. A command or a finished hop has a number
that is written last and read twice, so that an incomplete one is never used. This requires that stores become visible
in their order, as on x86-64; on ARM it holds in practice, since the interpreter executes much code between two stores.
"""

from enum import IntEnum
from math import nan
from multiprocessing.shared_memory import SharedMemory
from typing import NamedTuple, Self

from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_ring import attached_memory, created_memory
from stepgap.step import StepStatus

LONGEST_MESSAGE = 2048
"""Largest length of a message [bytes]."""


class Field(IntEnum):
    """Offsets of the fields, in words of 8 bytes."""

    REQUEST = 0
    EMERGENCY_STOP = 1
    COMMAND_NUMBER = 2
    FX = 3
    FY = 4
    STATE = 5
    HOP_NUMBER = 6
    SPEED = 7
    HEIGHT = 8
    REQUESTED_FX = 9
    REQUESTED_FY = 10
    APPLIED_FX = 11
    APPLIED_FY = 12
    YAW = 13
    STATUS = 14
    TICKS = 15
    MISSED_TICKS = 16
    WORST_LATENESS = 17
    PRESSES = 18
    MESSAGE_LENGTH = 19
    MESSAGE = 20


class Request(IntEnum):
    """Request of a person to the real-time process."""

    NOTHING = 0
    HOP = 1
    STOP = 2


class FinishedHop(NamedTuple):
    """Result of a hop.

    Attributes:
        number: Number of the hop, from 0 for the one that begins when the robot is released.
        speed: Speed at the apex [m/s]; NaN for a failed hop.
        height: Height at the apex [m]; NaN for a failed hop.
        requested_fx: Forward command force that was requested of the joints [N]; zero if none came in time.
        requested_fy: Upward command force that was requested of the joints [N].
        applied_fx: Forward command force that was actually applied [N].
        applied_fy: Upward command force that was actually applied [N].
        yaw: Yaw of the robot at the apex [rad]; NaN for a failed hop.
        status: OK, or the reason why there is no apex.
    """

    number: int
    speed: float
    height: float
    requested_fx: float
    requested_fy: float
    applied_fx: float
    applied_fy: float
    yaw: float
    status: StepStatus

    @classmethod
    def stopped(cls, number: int, status: StepStatus = StepStatus.STOPPED) -> Self:
        """Returns the result of a hop that was stopped before its apex."""
        return cls(number, nan, nan, 0.0, 0.0, 0.0, 0.0, nan, status)


class Board:
    """Shared memory of a real-time process and the process that started it.

    Args:
        memory: The shared memory, which `create` and `attach` open.
    """

    def __init__(self, memory: SharedMemory):
        assert memory.buf is not None  # until it is closed
        self._memory = memory
        self._words = memory.buf[: 8 * Field.MESSAGE].cast("q")
        self._numbers = memory.buf[: 8 * Field.MESSAGE].cast("d")
        self._message = memory.buf[8 * Field.MESSAGE :][:LONGEST_MESSAGE]

    @classmethod
    def create(cls) -> Self:
        """Creates a board, everything zero: no request, OFF, no command."""
        board = cls(created_memory(8 * Field.MESSAGE + LONGEST_MESSAGE))
        board._words[Field.COMMAND_NUMBER] = board._words[Field.HOP_NUMBER] = -1
        return board

    @classmethod
    def attach(cls, name: str) -> Self:
        """Opens the board that another process created."""
        return cls(attached_memory(name))

    @property
    def name(self) -> str:
        """Name by which another process attaches."""
        return self._memory.name

    @property
    def request(self) -> Request:
        """The latest request of a person."""
        return Request(self._words[Field.REQUEST])

    @request.setter
    def request(self, request: Request) -> None:
        self._words[Field.REQUEST] = request

    @property
    def emergency_stop(self) -> bool:
        """Whether the software stop was requested; the request cannot be revoked."""
        return self._words[Field.EMERGENCY_STOP] != 0

    @property
    def presses(self) -> int:
        """Number of times that the key came by which a person consents to torque, as long as it is held."""
        return self._words[Field.PRESSES]

    @presses.setter
    def presses(self, presses: int) -> None:
        self._words[Field.PRESSES] = presses

    def stop_at_once(self) -> None:
        """Requests the software stop: torque off at the next tick. Only a contactor or STO is an emergency stop."""
        self._words[Field.EMERGENCY_STOP] = 1

    def post_command(self, number: int, fx: float, fy: float) -> None:
        """Posts the command force of a hop [N]."""
        self._words[Field.COMMAND_NUMBER] = -1
        self._numbers[Field.FX], self._numbers[Field.FY] = fx, fy
        self._words[Field.COMMAND_NUMBER] = number

    def command(self, number: int) -> tuple[float, float] | None:
        """The command force of a hop [N]; None if it has not been posted."""
        words, numbers = self._words, self._numbers
        if words[Field.COMMAND_NUMBER] != number:
            return None
        command = numbers[Field.FX], numbers[Field.FY]
        return command if words[Field.COMMAND_NUMBER] == number else None

    @property
    def state(self) -> RigState:
        """State of the real-time process."""
        return RigState(self._words[Field.STATE])

    @state.setter
    def state(self, state: RigState) -> None:
        self._words[Field.STATE] = state

    def post_hop(self, hop: FinishedHop) -> None:
        """Posts the result of a hop."""
        self._words[Field.HOP_NUMBER] = -1
        for field, value in enumerate(hop[1:-1], start=Field.SPEED):
            self._numbers[field] = value
        self._words[Field.STATUS] = hop.status
        self._words[Field.HOP_NUMBER] = hop.number

    def hop(self, number: int) -> FinishedHop | None:
        """Result of a hop; None before it has ended and after the next one has ended."""
        words, numbers = self._words, self._numbers
        if words[Field.HOP_NUMBER] != number:
            return None
        values = numbers[Field.SPEED : Field.STATUS].tolist()
        found = FinishedHop._make((number, *values, StepStatus(words[Field.STATUS])))
        return found if words[Field.HOP_NUMBER] == number else None

    def count_tick(self, late: float, missed: int) -> None:
        """Counts a tick with its delay [s], and the ticks that were missed before it."""
        words, numbers = self._words, self._numbers
        words[Field.TICKS] += 1
        words[Field.MISSED_TICKS] += missed
        if late > numbers[Field.WORST_LATENESS]:
            numbers[Field.WORST_LATENESS] = late

    @property
    def ticks(self) -> int:
        """Number of ticks so far."""
        return self._words[Field.TICKS]

    @property
    def missed_ticks(self) -> int:
        """Number of missed ticks so far."""
        return self._words[Field.MISSED_TICKS]

    @property
    def worst_lateness(self) -> float:
        """Largest delay of a tick so far [s]."""
        return self._numbers[Field.WORST_LATENESS]

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
