"""How the package starts its own processes, and how many can run at once."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.context import SpawnContext

CONTEXT: SpawnContext = get_context("spawn")
"""Each is a new interpreter; a copy of this process (`fork`) would have locks whose threads were not copied."""


def process_context() -> SpawnContext:
    """Context of `multiprocessing` for processes that this one waits for; ask for it when one is started."""
    return CONTEXT


def usable_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def program_left_alone() -> Iterator[None]:
    """Processes that start within do not run the file of this program again, which they do unless it has a guard."""
    main = sys.modules["__main__"]
    kept = {name: vars(main)[name] for name in ("__file__", "__spec__") if name in vars(main)}
    for name in kept:
        setattr(main, name, None)
    try:
        yield
    finally:
        vars(main).update(kept)
