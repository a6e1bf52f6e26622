"""The console of a stream: what can be drawn again, such as a bar, or plain lines."""

from typing import TextIO

from rich.console import Console

from stepgap.cli.terminal import is_watched


def screen(stream: TextIO, plain_width: int | None = None) -> Console:
    """Console of a stream: with colours and bars where a person looks, otherwise plain.

    Args:
        stream: What it writes to.
        plain_width: Width of plain lines; None for that of the terminal, or 80.
    """
    watched = is_watched(stream)
    width = None if watched else plain_width
    return Console(file=stream, highlight=False, force_terminal=watched, width=width)
