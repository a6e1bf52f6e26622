"""The entry point of the program `stepgap`: Ctrl-C is one line, wherever it arrives."""

import sys
from types import TracebackType


def _stopped_in_a_line(
    kind: type[BaseException], error: BaseException, traceback: TracebackType | None
) -> None:  # Python calls it for Ctrl-C during the imports below, which take longest on a busy machine
    if issubclass(kind, KeyboardInterrupt):
        sys.stderr.write("stepgap: stopped\n")
    else:
        sys.__excepthook__(kind, error, traceback)


sys.excepthook = _stopped_in_a_line

import signal  # noqa: E402
from threading import Timer, main_thread  # noqa: E402

from stepgap.base.child_environment import import_nothing_from_here  # noqa: E402
from stepgap.cli.terminal import STOPPED, warn  # noqa: E402


def start() -> None:
    """Runs the command line of the program."""
    sys.unraisablehook = _repeat_interrupt
    import_nothing_from_here()
    try:
        from stepgap.cli.app import main  # takes some tenths of a second

        main()
    except KeyboardInterrupt:
        warn("stopped")
        _end_stopped()
    except SystemExit as end:
        if end.code == STOPPED:
            _end_stopped()
        raise


def _repeat_interrupt(unraisable: "sys.UnraisableHookArgs") -> None:
    """Interrupts again if Ctrl-C arrived in a callback of C, as of the compiler, where Python would only print it."""
    if isinstance(unraisable.exc_value, KeyboardInterrupt):
        again = main_thread().ident, signal.SIGINT
        Timer(0.05, signal.pthread_kill, again).start()  # after the callback; it also ends a call that waits
    else:
        sys.__unraisablehook__(unraisable)


def _end_stopped() -> None:
    """Ends the program; objects of the compiler that Ctrl-C left half made print no errors when they are deleted."""
    sys.unraisablehook = lambda _: None
    sys.exit(STOPPED)
