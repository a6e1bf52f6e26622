"""Times at which frames arrive at a socket, as the kernel stamps them: a ring that is busy does not falsify them."""

import socket
from struct import Struct
from time import monotonic_ns, time_ns

from stepgap.hardware.ethercat.emulator.frame import LONGEST_FRAME

_SO_TIMESTAMPNS = 35
"""Socket option of Linux, and the type of its message; Python has no name for it."""

_TIMESPEC = Struct("@ll")


class ArrivalTimes:
    """Receives frames; called, it returns when the last one arrived [ns], on the monotonic clock."""

    def __init__(self) -> None:
        self._ahead, self._last = time_ns() - monotonic_ns(), monotonic_ns()

    def __call__(self) -> int:
        """Returns the time [ns]."""
        return self._last

    @staticmethod
    def enable(raw: socket.socket) -> None:
        """Lets the kernel stamp the frames of a socket."""
        raw.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)

    def receive(self, raw: socket.socket) -> bytes:
        """Receives a frame and keeps its time."""
        frame, messages, _, _ = raw.recvmsg(LONGEST_FRAME, socket.CMSG_SPACE(_TIMESPEC.size))
        self._last = monotonic_ns()
        for level, kind, data in messages:
            if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS):
                seconds, nanoseconds = _TIMESPEC.unpack(data)
                self._last = 10**9 * seconds + nanoseconds - self._ahead
        return frame
