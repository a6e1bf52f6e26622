"""Matplotlib in the style of StepGap: no setting of the user changes a figure, or prevents one."""

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from stepgap.base.garbage_collection import paused_collection


@contextmanager
def own_style(settings: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Draws what is drawn inside with Matplotlib's defaults, changed by `settings`.

    Neither a `matplotlibrc` nor the environment variable `MPLBACKEND` counts. A notebook sets the latter for all
    processes that it starts, and where it names a backend that is not installed, Matplotlib cannot even be imported;
    so modules that import it are to be imported inside, too. All figures are drawn by Agg, without pyplot. A
    `matplotlibrc` that cannot be read, because it is not UTF-8 or not this user's, is passed over. Figures
    that pyplot draws afterwards, as in the next cell of a notebook, have the backend of the variable.
    """
    first = "matplotlib" not in sys.modules
    try:
        with _environment(MPLBACKEND=None):
            import matplotlib
    except (UnicodeDecodeError, PermissionError):
        for name in [name for name in sys.modules if name.startswith("matplotlib.")]:
            del sys.modules[name]  # what the failed import left would be taken for parts of the next one
        with _environment(MPLBACKEND=None, MATPLOTLIBRC=_default_file()):
            import matplotlib
    backend = os.environ.get("MPLBACKEND")
    if first and backend:
        with suppress(ValueError):  # there is no such backend
            matplotlib.rcParams["backend"] = backend
    with matplotlib.rc_context(), paused_collection():  # collections would take an eighth of the time
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(dict[Any, Any](settings or {}))
        yield


def _default_file() -> str:
    """Path of the `matplotlibrc` in Matplotlib's package."""
    spec = find_spec("matplotlib")
    (folder,) = spec.submodule_search_locations or [""] if spec else [""]
    return str(Path(folder, "mpl-data", "matplotlibrc"))


@contextmanager
def _environment(**values: str | None) -> Iterator[None]:
    """Sets environment variables, None to remove one, as long as the context lasts."""
    before = {name: os.environ.get(name) for name in values}
    _set(values)
    try:
        yield
    finally:
        _set(before)


def _set(values: Mapping[str, str | None]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
