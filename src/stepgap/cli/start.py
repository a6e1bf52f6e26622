"""The entry point of the program `stepgap`: Ctrl-C is one line, wherever it arrives."""

import signal
import sys
from threading import Timer, main_thread

from stepgap.base.child_environment import import_nothing_from_here
from stepgap.cli.terminal import STOPPED, warn


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
