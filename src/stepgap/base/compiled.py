"""Compilation by Numba: `compiled` with a disk cache that can be trusted, `implements` for dispatch.

Numba's own cache checks only the file of the compiled function, so a function would keep the old
version of a function that it calls from another file; and it is named after the path of that file, so that
each checkout would compile again. Here the name of the cache folder is the digest of all compiled sources of
the function's package, wherever they are.

A wheel may bring compiled code along (`.ci/wheel_objects.py`), which is used where it fits.
"""

# pyright: reportAttributeAccessIssue=false
# (Numba creates the attributes of its config at run time.)

import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache, lru_cache
from pathlib import Path
from platform import machine, system
from types import FunctionType
from typing import Any, Self, final

import numba
from numba.core import config
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import overload

OPTIONS = {"nogil": True, "error_model": "numpy", "fastmath": {"contract", "arcp", "nsz"}}
"""No interpreter lock; IEEE division, by a reciprocal where that is shared; products may be fused with sums.

Sums are not regrouped: Numba tests whether x is finite by x − x, which would always be 0 then.
"""

OBJECTS = "objects"
"""Folder of a package that has compiled code of it, in a folder named as in the cache, with `TARGET_FILE`."""

TARGET_FILE = "target.json"
"""Which computers can run the code: `machine` and `system` as Python names them, `features` of the processor as LLVM
names them; and `target`, by which Numba's index names what it was compiled for."""

KEPT_VERSIONS = 12  # Number of versions of compiled code, some 10 MB each, that remain in the cache

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
    digest = hashlib.sha256(numba.__version__.encode())
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
    return _inner(function, OPTIONS, numba.njit)


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles `function` with Numba under `OPTIONS`, cached on disk.

    Functions compiled with it may call each other and take each other as arguments.
    """
    return _inner(function, OPTIONS, _cached)


def as_written(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles under `AS_WRITTEN`, cached on disk: results are bit for bit those of the same lines in Python."""
    return _inner(function, AS_WRITTEN, _cached)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles as `compiled` and inlines the function into its callers, which omit the results they do not use."""
    return _inner(function, {**OPTIONS, "forceinline": True}, _cached)


def from_python(function: Any) -> Callable[..., Any]:
    """A decorator above one of the others: Python calls the function as often as compiled code does.

    Then it has one version instead of two.
    """
    return function.for_python()


def _inner(
    function: Callable[..., Any], options: dict[str, Any], compile_by: Callable[..., Callable[..., Any]]
) -> Callable[..., Any]:
    """A function for compiled callers, without the code that unpacks Python's objects: half of the compilation.

    A call from Python compiles another version, which has that code.
    """
    dispatcher: Any = compile_by(**options, no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)
    copy = FunctionType(function.__code__, function.__globals__, argdefs=function.__defaults__)
    copy.__module__ = function.__module__
    copy.__qualname__ = f"{function.__qualname__}_for_python"  # by which Numba names its file in the cache
    dispatcher.for_python = cache(lambda: compile_by(**options)(copy))
    insert = dispatcher._insert
    entered: set[tuple[int, ...]] = set()

    def compile_for_python(*given: Any) -> Any:
        """Called where no version for Python is known for the types of arguments; returns the entry of one.

        Two threads may come here at the same time. A second version for Python would take its entry with it when it is
        freed; and of two equal entries Numba finds none, but asks here in every call, which takes twenty times as long.
        """
        with global_compiler_lock:
            version = dispatcher.for_python()
            entry = version._compile_for_args(*given)
            types = tuple(version.typeof_pyval(value)._code for value in given)
            if types not in entered:
                entered.add(types)
                insert(list(types), entry, False)
        return entry

    dispatcher._insert = lambda *_: None  # the versions for compiled code are not for Python
    dispatcher._compile_for_args = compile_for_python
    return dispatcher


def _cached(**options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """As `numba.njit`, with the cache, if there is one."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        if cache_folder() is None or not Path(function.__code__.co_filename).is_file():
            return numba.njit(**options)(function)
        previous = config.CACHE_LOCATOR_CLASSES
        config.CACHE_LOCATOR_CLASSES = f"{ContentLocator.__module__}.{ContentLocator.__name__}"
        try:
            dispatcher: Any = numba.njit(**options)(function)
            dispatcher._cache = _Cache(function)
            return dispatcher
        finally:
            config.CACHE_LOCATOR_CLASSES = previous

    return decorate


class _Cache(FunctionCache):
    """Numba's cache of a function, before which objects of its package are used, if there are some that fit.

    So results do not depend on what else a user's cache contains. Files of both are pickled. Those of the package are
    trusted as its source and its `.pyc` files are, in whose folder they lie; no other file is read in this way.
    """

    def _load_overload(self, sig: Any, target_context: Any) -> Any:
        codegen = target_context.codegen()
        locator = self._impl.locator
        if (target := _target(locator.objects, codegen.magic_tuple())) is not None:
            folder = str(locator.objects / locator.module)
            signature, _, code = self._index_key(sig, codegen)
            index = IndexDataCacheFile(folder, self._impl.filename_base, locator.get_source_stamp())
            if (data := index.load((signature, target, code))) is not None:
                return self._impl.rebuild(target_context, data)
        return super()._load_overload(sig, target_context)


@lru_cache
def _target(objects: Path, host: tuple[str, str, str]) -> tuple[str, ...] | None:
    """What the objects of a folder were compiled for; None if there are none, or none for this computer.

    Numba describes the computer, `host`, by triple, processor and features such as "+avx2".
    """
    if not (objects.parents[1] / "__init__.py").is_file():
        return None  # beside a script there may be anything
    try:
        made = json.loads((objects / TARGET_FILE).read_text("utf-8"))
    except (OSError, ValueError):
        return None
    lacking = {f"+{feature}" for feature in made["features"]} - set(host[2].split(","))
    fits = (made["machine"], made["system"]) == (machine(), system()) and not lacking and config.CPU_NAME is None
    return tuple(made["target"]) if fits else None


@final
class ContentLocator:
    """Tells Numba where the compiled code of a function is: in a folder that is named after the content of its package.

    Numba makes it by `from_function` and calls the other methods (its variable NUMBA_CACHE_LOCATOR_CLASSES).

    Attributes:
        module: Name of the folder of the source as a module, in the cache and below `objects`.
        objects: Folder of what a wheel brought along for this content; it need not be there.
    """

    def __init__(self, function: Callable[..., Any], file: str):
        source = Path(file).resolve()
        package = _package_folder(source)
        home = cache_folder()
        assert home is not None, "Numba is asked to use a cache only if there is one"
        self._py_file = file
        self._line = function.__code__.co_firstlineno
        self._stamp = f"{_digest(_package_folder(Path(__file__).resolve()))}-{_digest(package)}"
        self.module = ".".join(source.relative_to(package.parent).parent.parts)
        self.objects = package / OBJECTS / self._stamp
        self._folder = _used(home / self._stamp) / self.module

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> Self:
        """The locator of a function."""
        locator = cls(function, file)
        locator.ensure_cache_path()
        return locator

    def ensure_cache_path(self) -> None:
        """Makes the folder."""
        self._folder.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """The folder."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """What must be equal for the code to be valid: the content, and not the time of a file."""
        return self._stamp

    def get_disambiguator(self) -> str:
        """What distinguishes functions of the same name in a file: the line."""
        return str(self._line)


@lru_cache
def _used(folder: Path) -> Path:
    """Notes that a version of the code is in use; before a new one, removes those that were not used for longest."""
    with suppress(OSError):  # another process has just removed one
        if not folder.exists():
            named = re.compile("[0-9a-f]{16}-[0-9a-f]{16}").fullmatch
            versions = [(path.stat().st_mtime, path) for path in folder.parent.iterdir() if named(path.name)]
            for _, old in sorted(versions)[: 1 - KEPT_VERSIONS]:
                shutil.rmtree(old, ignore_errors=True)
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    return folder


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
