"""The entry point of the program `stepgap`: Ctrl-C is one line also while the verbs are imported."""

import sys

from stepgap.cli.terminal import STOPPED, warn


def start() -> None:
    """Runs the command line of the program."""
    try:
        from stepgap.cli.app import main  # takes some tenths of a second

        main()
    except KeyboardInterrupt:
        warn("stopped")
        sys.exit(STOPPED)
