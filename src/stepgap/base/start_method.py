"""How the package starts its own processes, and how many can run at once."""

import os
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
