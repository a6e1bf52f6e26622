"""How the package starts its own processes."""

from multiprocessing import get_context
from multiprocessing.context import SpawnContext

CONTEXT: SpawnContext = get_context("spawn")
"""Each is a new interpreter; a copy of this process (`fork`) would have locks whose threads were not copied."""


def process_context() -> SpawnContext:
    """Context of `multiprocessing` for processes that this one waits for; ask for it when one is started."""
    return CONTEXT
