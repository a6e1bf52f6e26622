"""The environment of processes that this one starts: what of the current folder Python may import in them."""

import os

_SAFE_PATH = ("PYTHONSAFEPATH", "stepgap")
"""By any value of it Python imports nothing from the current folder; this one says that the program has set it."""


def import_nothing_from_here() -> None:
    """From now on, Python processes that this one starts do not import modules of the current folder.

    Such processes are started by `python -c`, which would take a `struct.py` of a stranger's folder for Python's own.
    """
    os.environ.setdefault(*_SAFE_PATH)


def environment_of_user() -> dict[str, str]:
    """The environment for a program of the user, which may import what lies beside it."""
    return {name: value for name, value in os.environ.items() if (name, value) != _SAFE_PATH}
