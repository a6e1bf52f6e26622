"""Compilation by Numba: `compiled` with a disk cache that can be trusted, `implements` for dispatch.

Numba's own cache checks only the file of the compiled function, so a function would keep the old
version of a function that it calls from another file. Here the name of the cache folder is the digest
of all compiled sources of the function's package.
"""

# pyright: reportAttributeAccessIssue=false
# (Numba creates the attributes of its config at run time.)

import hashlib
import os
import re
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
from numba.core import config
from numba.extending import overload

OPTIONS = {"nogil": True, "error_model": "numpy", "fastmath": {"contract", "arcp", "nsz"}}
"""No interpreter lock; IEEE division, by a reciprocal where that is shared; products may be fused with sums.

Sums are not regrouped: Numba tests whether x is finite by x − x, which would always be 0 then.
"""

AS_WRITTEN = {"nogil": True, "error_model": "numpy"}
"""As `OPTIONS`, but every product, quotient and sum is rounded separately, as in Python and NumPy."""


@lru_cache
def _digest(package: Path) -> str:
    """Digest of all source files below `package` that use `compiled`, and of those that they import from it.

    The imported files count because Numba freezes the constants that a compiled function uses.
    """
    is_package = (package / "__init__.py").exists()
    files = package.rglob("*.py") if is_package else package.glob("*.py")  # a script may lie anywhere
    sources = {path: path.read_bytes() for path in files}
    relevant = {path for path, source in sources.items() if b"compiled" in source}
    for path in list(relevant):
        for module in re.findall(rb"^from (\S+) import", sources[path], re.MULTILINE):
            file = package.parent.joinpath(*module.decode(errors="replace").split("."))
            relevant |= {file.with_suffix(".py"), file / "__init__.py"} & sources.keys()
    digest = hashlib.sha256()
    for path in sorted(relevant):
        digest.update(str(path.relative_to(package)).encode() + b"\0" + sources[path])
    return digest.hexdigest()[:16]


@lru_cache
def cache_folder() -> Path | None:
    """First writable folder for compiled code, or None."""
    folders = [Path(tempfile.gettempdir()) / "stepgap-cache"]
    with suppress(RuntimeError):  # there may be no home
        folders.insert(0, Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "stepgap")
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    for folder in [Path(chosen)] if chosen else folders:
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


def generic(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a function whose argument may be of a type that another program defines; it is not cached.

    A cache would refer to that type, and a process that cannot import the type could not read the cache.
    The compiled functions that call this function are cached, and their cache includes it.
    """
    return numba.njit(**OPTIONS)(function)


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles `function` with Numba under `OPTIONS`, cached on disk.

    Functions compiled with it may call each other and take each other as arguments.
    """
    return _cached(function, OPTIONS)


def as_written(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles under `AS_WRITTEN`, cached on disk: results are bit for bit those of the same lines in Python."""
    return _cached(function, AS_WRITTEN)


def _cached(function: Callable[..., Any], options: dict[str, Any]) -> Callable[..., Any]:
    file, cache = Path(function.__code__.co_filename).resolve(), cache_folder()
    if cache is None or not file.is_file():
        return numba.njit(**options)(function)
    previous = config.CACHE_DIR
    own_digest = _digest(_package_folder(Path(__file__).resolve()))
    function_digest = _digest(_package_folder(file))
    config.CACHE_DIR = str(cache / f"{own_digest}-{function_digest}")
    try:
        return numba.njit(cache=True, **options)(function)
    finally:
        config.CACHE_DIR = previous


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles as `compiled` and inlines the function into its callers, which omit the results they do not use."""
    return _cached(function, {**OPTIONS, "forceinline": True})


def implements(operation: Callable[..., Any], system_type: type) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Registers the implementation of `operation` for compiled code whose first argument is a `system_type`.

    This is `functools.singledispatch` for compiled code. Functions passed as arguments would work too,
    but Numba cannot cache their callers. The implementation must have the parameter names of `operation`.
    """

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        implementation = compiled(function)

        @overload(operation, strict=False)
        def choose(system, *rest):  # pyright: ignore[reportUnusedFunction]
            if getattr(system, "instance_class", None) is system_type:
                return lambda system, *rest: implementation(system, *rest)
            return None

        return implementation

    return register
