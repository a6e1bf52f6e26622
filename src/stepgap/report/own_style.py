"""Matplotlib in the style of StepGap: no setting of the user changes a figure, or prevents one."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from stepgap.base.garbage_collection import paused_collection


@contextmanager
def own_style(settings: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Draws what is drawn inside with Matplotlib's defaults, changed by `settings`.

    Neither a `matplotlibrc` nor the environment variable `MPLBACKEND` counts. A notebook sets the latter for all
    processes that it starts, and where it names a backend that is not installed, Matplotlib cannot even be imported;
    so modules that import it are to be imported inside, too. All figures are drawn by Agg, without pyplot.
    """
    backend = os.environ.pop("MPLBACKEND", None)
    try:
        import matplotlib
    finally:
        if backend is not None:
            os.environ["MPLBACKEND"] = backend
    with matplotlib.rc_context(), paused_collection():  # collections would take an eighth of the time
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(dict[Any, Any](settings or {}))
        yield
