"""Compilation by Numba: `compiled` with a disk cache that can be trusted, `implements` for dispatch.

Numba's own cache looks at the file of the compiled function alone, so a kernel would go on with the
old version of a function it calls from another file. Here the cache lies in a folder named after the
digest of all compiled sources of the function's package.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
from numba.extending import overload


@lru_cache
def _digest(package: Path) -> str:
    """Digest of all source files below `package` that use `compiled`."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        source = path.read_bytes()
        if b"compiled" in source:
            digest.update(str(path.relative_to(package)).encode() + b"\0" + source)
    return digest.hexdigest()[:16]


@lru_cache
def _cache_folder() -> Path | None:
    """First folder for compiled code that can be written, or None."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for folder in [Path(chosen)] if chosen else [user / "stepgap", Path(tempfile.gettempdir()) / "stepgap-cache"]:
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError:
            continue
        if os.access(folder, os.W_OK) and folder.stat().st_uid == os.getuid():
            return folder
    return None


def _package_folder(file: Path) -> Path:
    """The topmost package that `file` belongs to."""
    folder = file.parent
    while (folder.parent / "__init__.py").exists():
        folder = folder.parent
    return folder


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles `function` with Numba: no interpreter lock, IEEE division, cached on disk.

    Functions compiled with it may call each other and take each other as arguments.
    """
    cache = _cache_folder()
    if cache is None:
        return numba.njit(nogil=True, error_model="numpy")(function)
    previous = numba.config.CACHE_DIR
    here = _digest(_package_folder(Path(__file__).resolve()))
    there = _digest(_package_folder(Path(function.__code__.co_filename).resolve()))
    numba.config.CACHE_DIR = str(cache / f"{here}-{there}")
    try:
        return numba.njit(nogil=True, error_model="numpy", cache=True)(function)
    finally:
        numba.config.CACHE_DIR = previous


def implements(generic: Callable[..., Any], system_type: type) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Registers the implementation of `generic` for compiled code whose first argument is a `system_type`.

    The like of `functools.singledispatch` for compiled code: functions passed as arguments would work
    too, but Numba cannot cache their callers. The implementation must have the parameter names of
    `generic`.
    """

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        implementation = compiled(function)

        @overload(generic, strict=False)
        def choose(system, *rest):  # pyright: ignore[reportUnusedFunction]
            if getattr(system, "instance_class", None) is system_type:
                return lambda system, *rest: implementation(system, *rest)
            return None

        return implementation

    return register
