"""Versions of the software that a result depends on."""

import platform
from functools import cache
from importlib.metadata import version

RECORDED_PACKAGES = ("stepgap", "numpy", "scipy", "numba", "mujoco")
"""Packages whose versions a run records: with other versions the same seed may give other last digits."""


def versions_here() -> dict[str, str]:
    """Version of Python and of each recorded package, by its name."""
    return {"python": platform.python_version(), **{name: _version(name) for name in RECORDED_PACKAGES}}


@cache
def _version(package: str) -> str:
    """Version of an installed package; to read its metadata takes milliseconds."""
    return version(package)
