"""What every benchmark needs: the time of a call, peers that are no part of the package, the machine it ran on."""

import os
import platform
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter
from typing import Any

Progress = Callable[[str], None]
"""Called with a line that says how far a benchmark is."""


def timed(call: Callable[[], object]) -> float:
    """Duration of a call [s]."""
    begin = perf_counter()
    call()
    return perf_counter() - begin


@contextmanager
def peers(module: str) -> Iterator[Any]:
    """A module of `benchmarks/peers`, or None outside of a checkout."""
    root = Path(__file__).parents[3]
    if not (root / "benchmarks" / "peers" / f"{module}.py").is_file():
        yield None
        return
    sys.path.insert(0, str(root))
    try:
        yield import_module(f"benchmarks.peers.{module}")
    finally:
        sys.path.remove(str(root))


def machine(packages: Sequence[str]) -> dict[str, Any]:
    """Processor, cores, load, and the versions of Python and of those packages that are installed."""
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
