"""Versions of the software that a result depends on, and how further packages are installed."""

import platform
from functools import cache
from pathlib import Path

RECORDED_PACKAGES = ("stepgap", "numpy", "scipy", "numba", "mujoco")
"""Packages whose versions a run records: with other versions the same seed may give other last digits."""

INSTALL = "./go uv pip install" if (Path(__file__).parents[3] / "go").is_file() else "pip install"
"""Command that installs a package: in a clone of the repository, or elsewhere."""


def versions_here() -> dict[str, str]:
    """Version of Python and of each recorded package, by its name."""
    return {"python": platform.python_version(), **{name: _version(name) for name in RECORDED_PACKAGES}}


@cache
def _version(package: str) -> str:
    """Version of an installed package; to read its metadata takes milliseconds."""
    from importlib.metadata import version  # a process that records no version starts without this import

    return version(package)
