"""Processes of this machine that compute cases."""

import os
import signal
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import suppress
from multiprocessing import connection, parent_process
from queue import SimpleQueue
from threading import Event, Thread
from time import sleep
from typing import Any, final

from stepgap.base.errors import StepGapError
from stepgap.base.start_method import process_context

ATTEMPTS = 3
"""Number of processes that may end during one call before the call fails."""


GRACE = 5.0
"""Time that a process has to end by itself [s]."""


class ProcessEnded(StepGapError):
    """The process of a call ended before the call, and so did those that tried it again."""


@final
class Processes(Executor):
    """An executor like `ProcessPoolExecutor` whose calls survive the end of a process.

    A process that ends, such as by a crash in compiled code or for lack of memory, is replaced, and its call is made
    again; the standard library's executor would give up all calls. No process outlives this one.

    Args:
        count: Number of processes.
    """

    def __init__(self, count: int):
        self._threads = ThreadPoolExecutor(count, thread_name_prefix="case")
        self._idle: SimpleQueue[_Process] = SimpleQueue()
        self._closed = Event()
        self._all = [_Process(self._closed) for _ in range(count)]
        for process in self._all:
            self._idle.put(process)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Calls a function of a module in one of the processes.

        The future raises the function's error, or `ProcessEnded`.
        """
        return self._threads.submit(self._call, fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Ends the processes: with `wait` after all calls, otherwise at once, so that unfinished calls fail."""
        if not wait:
            self._closed.set()
            for process in self._all:
                process.interrupt()
        self._threads.shutdown(wait=True, cancel_futures=cancel_futures or not wait)
        for process in self._all:
            process.end()

    def _call(self, *call: Any) -> Any:
        process, code = self._idle.get(), None
        try:
            for _ in range(ATTEMPTS):
                try:
                    return process.call(call)
                except EOFError:
                    code = process.end()
                if self._closed.is_set():
                    raise ProcessEnded("it was stopped")
            raise ProcessEnded(f"its process ended {ATTEMPTS} times, the last time with exit code {code}")
        finally:
            self._idle.put(process)


class _Process:
    """A process that is started when it is first needed, and again after its end. One thread at a time uses it.

    Args:
        closed: Whether calls are refused; set it before `interrupt`.
    """

    def __init__(self, closed: Event):
        self._closed = closed
        self._process: Any = None

    def call(self, call: Any) -> Any:
        """Makes a call; raises EOFError if the process ends during the call, or calls are refused."""
        if self._process is None:
            self._start()
        if self._closed.is_set():  # not before the start, which could come after an interrupt
            raise EOFError
        try:
            self._pipe.send(call)
            value, error = self._pipe.recv()
        except ConnectionError:
            raise EOFError from None
        if error is not None:
            raise error
        return value

    def _start(self) -> None:
        context = process_context()
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs,), daemon=True)
        try:
            process.start()
        except BaseException:
            ours.close()
            raise
        finally:
            theirs.close()
        self._process, self._pipe = process, ours

    def interrupt(self) -> None:
        """Asks the process to end its call; any thread may call this."""
        process = self._process
        if process is not None and process.is_alive():
            process.terminate()

    def end(self) -> int | None:
        """Ends the process, if there is one, and returns its exit code."""
        if self._process is None:
            return None
        self._pipe.close()  # without a call, the process ends
        self._process.join(GRACE)
        self._process.kill()
        self._process.join()
        code, self._process = self._process.exitcode, None
        return code


def _serve(pipe: connection.Connection) -> None:
    """Answers calls until the other end is closed or its process ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes of a terminal; the first one decides
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that a call removes its temporary files
    Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, ConnectionError, KeyboardInterrupt):
        while True:
            function, args, kwargs = pipe.recv()
            try:
                answer = function(*args, **kwargs), None
            except Exception as error:
                answer = None, error
            pipe.send(answer)


def _end_with_parent() -> None:
    """Ends this process when its parent has ended, even during a call."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)
        sleep(GRACE)
        os._exit(1)
