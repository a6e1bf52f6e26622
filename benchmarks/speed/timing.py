"""Functions for all benchmarks: the time of a call, and the description of the machine."""

import os
import platform
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from time import perf_counter
from typing import Any

Announce = Callable[[str], None]
"""Function that receives a line with the name of the next measurement."""


def timed(call: Callable[[], object]) -> float:
    """Duration of a call [s]."""
    begin = perf_counter()
    call()
    return perf_counter() - begin


def machine(packages: Sequence[str]) -> dict[str, Any]:
    """Processor, cores, load, and the versions of Python and of the installed packages."""
    return {
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        **{name: found for name in packages if (found := _version(name)) is not None},
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
