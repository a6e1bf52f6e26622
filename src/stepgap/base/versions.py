"""Versions of the software that a result depends on, and how further packages are installed."""

import platform
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from stepgap.base.errors import InputError

RECORDED_PACKAGES = ("stepgap", "numpy", "scipy", "numba", "mujoco")
"""Packages whose versions a run records: with other versions the same seed may give other last digits."""

INSTALL = "./go uv pip install" if (Path(__file__).parents[3] / "go").is_file() else "pip install"
"""Command that installs a package: in a clone of the repository, or elsewhere."""


def optional_package(module: str, user: str, extra: str) -> Any:
    """A module of a package that only some installations have, by the `extra` of StepGap; `user` is what needs it.

    Raises:
        InputError: It is not installed; the message is the command that installs it.
    """
    try:
        return import_module(module)
    except ImportError:
        package = module.partition(".")[0]
        raise InputError(f"{user} needs {package}: {INSTALL} 'stepgap[{extra}]'") from None


def versions_here() -> dict[str, str]:
    """Version of Python and of each recorded package, by its name."""
    return {"python": platform.python_version(), **{name: _version(name) for name in RECORDED_PACKAGES}}


@cache
def _version(package: str) -> str:
    """Version of an installed package; to read its metadata takes milliseconds."""
    from importlib.metadata import version  # a process that records no version starts without this import

    return version(package)
