"""Lines of text to and from another program, over pipes or a socket, with timeouts."""

import contextlib
import os
import signal
import socket
import subprocess
from abc import ABC, abstractmethod
from collections.abc import Sequence
from queue import Empty, SimpleQueue
from threading import Thread
from typing import IO, final

from stepgap.base.child_environment import environment_of_user
from stepgap.plants.process.messages import ProcessFault

LONGEST_LINE = 65536  # Largest number of bytes of a line
MOST_WAITING = 16  # Number of lines without a question after which the program is not listened to any more
CONNECTING = 5.0  # Timeout of a connection [s]


class LineChannel(ABC):
    """A program that is connected.

    A thread reads its lines, so that waiting for one can have a timeout on every system.
    """

    def __init__(self, reader: IO[bytes], writer: IO[bytes]):
        self._writer = writer
        self._lines = SimpleQueue[bytes | None]()
        self._flooded = False
        self._thread = Thread(target=self._read, args=(reader,), daemon=True)
        self._thread.start()

    def _read(self, reader: IO[bytes]) -> None:
        with contextlib.suppress(OSError, ValueError):  # closed while reading
            while (line := reader.readline(LONGEST_LINE + 1)) and not self._flooded:
                self._lines.put(line)
                self._flooded = self._lines.qsize() > MOST_WAITING
        self._lines.put(None)

    def send(self, line: str) -> None:
        """Sends a line.

        Raises:
            ProcessFault: The program has closed its input.
        """
        try:
            self._writer.write(line.encode())
            self._writer.flush()
        except (OSError, ValueError):
            raise ProcessFault(self.ended()) from None

    def receive(self, timeout: float) -> str:
        """Waits for the next line.

        Args:
            timeout: Longest time to wait [s].

        Raises:
            ProcessFault: There is none in time, the program ended, or the line is too long or not UTF-8.
        """
        try:
            line = self._lines.get(timeout=timeout)
        except Empty:
            raise ProcessFault(f"the program did not answer within {timeout:g} s") from None
        if line is None:
            self._lines.put(None)
            flooded = f"the program sent more than {MOST_WAITING} lines that nobody asked for"
            raise ProcessFault(flooded if self._flooded else self.ended())
        if len(line) > LONGEST_LINE:
            raise ProcessFault(f"the program answered by a line of more than {LONGEST_LINE} bytes")
        try:
            return line.decode()
        except UnicodeDecodeError:
            raise ProcessFault("the program answered by a line that is not UTF-8") from None

    def check_quiet(self) -> None:
        """Checks that there is no line that nobody asked for.

        Raises:
            ProcessFault: There is one.
        """
        if not self._lines.empty():
            line = self.receive(0.0)
            raise ProcessFault(f"the program sent a second answer: {line.strip()!r:.80}")

    @abstractmethod
    def ended(self) -> str:
        """Message that the program ended."""

    @abstractmethod
    def close(self, patience: float) -> None:
        """Closes its input, and waits for the end of the program at most `patience` seconds; may be called twice."""


@final
class Child(LineChannel):
    """A program that is started here; lines go through its standard input and output.

    It does not receive Ctrl-C, which would end it before the robot is at rest. Its standard error stays that of the
    terminal.

    Args:
        command: Program and its arguments.

    Raises:
        ProcessFault: It cannot be started.
    """

    def __init__(self, command: Sequence[str]):
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,
                env=environment_of_user(),
            )
        except OSError as error:
            raise ProcessFault(f"{command[0]}: cannot be started: {error.strerror}") from None
        assert self._process.stdin
        assert self._process.stdout
        super().__init__(self._process.stdout, self._process.stdin)

    def ended(self) -> str:
        """Message with its exit code, or that it closed its output."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self._process.wait(1.0)
            return f"the program was ended by signal {-code}" if code < 0 else f"the program ended with code {code}"
        return "the program closed its input or output"

    def close(self, patience: float) -> None:
        """Closes its input; ends it and its own children by SIGTERM and then SIGKILL if it does not end by itself."""
        with contextlib.suppress(OSError):
            self._writer.close()
        for ending in (None, signal.SIGTERM, signal.SIGKILL):
            if ending:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(self._process.pid, ending)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(patience)
                break
        self._thread.join(patience)
        if not self._thread.is_alive():  # otherwise another process, which it left behind, holds its output open
            assert self._process.stdout
            self._process.stdout.close()


@final
class Connection(LineChannel):
    """A program that listens on a TCP port of this computer.

    Raises:
        ProcessFault: Nothing listens there.
    """

    def __init__(self, port: int):
        try:
            self._socket = socket.create_connection(("127.0.0.1", port), CONNECTING)
        except OSError as error:
            reason = error.strerror or error
            raise ProcessFault(f"127.0.0.1:{port}: {reason}; start the robot's program first") from None
        self._socket.settimeout(None)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._port = port
        self._reader = self._socket.makefile("rb")
        super().__init__(self._reader, self._socket.makefile("wb"))

    def ended(self) -> str:
        """Message that the connection is closed."""
        return f"the program at 127.0.0.1:{self._port} closed the connection"

    def close(self, patience: float) -> None:
        """Closes the connection; the program continues."""
        with contextlib.suppress(OSError):
            self._writer.close()
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join(patience)
        self._reader.close()
        self._socket.close()
