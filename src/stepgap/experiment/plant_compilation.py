"""Compilation of a simulated plant beside that of the map: on two cores a first run waits half as long."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.process import BaseProcess

import numpy as np

from stepgap.base.compiled import cache_folder
from stepgap.base.compiling import on_compilation
from stepgap.base.start_method import process_context, usable_cores
from stepgap.experiment.plants import simulation_of
from stepgap.experiment.settings import Experiment


@contextmanager
def plant_compiled_beside(settings: Experiment) -> Iterator[None]:
    """Another process compiles the plant as soon as this one compiles within the block, and is awaited at its end.

    It leaves the code in the cache on disk, where this process finds it. It is only there to save time: what it cannot
    do, or make, is left to this process, which then reports the error.
    """
    others = list[BaseProcess]()

    def begin(functions: int, _seconds: float) -> None:
        if not functions:
            with suppress(Exception):
                other = process_context().Process(target=_compile_plant, args=(settings,), daemon=True)
                other.start()
                others.append(other)

    if not settings.simulated or usable_cores() < 2 or cache_folder() is None:
        yield
        return
    try:
        with on_compilation(begin):
            yield
        for other in others:
            other.join()
    finally:
        for other in others:
            other.terminate()
            other.join()


def _compile_plant(settings: Experiment) -> None:
    """Starts a plant, which calls all that its steps call."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits
    with suppress(Exception):
        if plant := simulation_of(settings).repeatable_plant(np.random.default_rng(0)):
            with plant:
                plant.start()
