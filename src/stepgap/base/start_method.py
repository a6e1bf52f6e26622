"""How the package starts its own processes."""

from multiprocessing import get_context
from multiprocessing.context import ForkServerContext, SpawnContext
from typing import Literal

START_METHOD: Literal["spawn", "forkserver"] = "spawn"
"""A new interpreter each time: a copy of this process (`fork`) would have its locks, but not the threads that hold them."""


def process_context() -> SpawnContext | ForkServerContext:
    """Context of `multiprocessing` for processes that this one waits for; ask for it when one is started."""
    return get_context(START_METHOD)
