"""Less work for the garbage collector, where it finds little."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def settled_heap() -> Iterator[None]:
    """The garbage collector disregards all objects that exist at the beginning of the block, until its end.

    Otherwise it visits all that was imported again and again. A visit takes 50 ms, which would be missing from the time
    in which a command is planned. Nothing changes if the caller has frozen objects already (`gc.freeze`).
    """
    if gc.get_freeze_count():
        yield
        return
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@contextmanager
def paused_collection() -> Iterator[None]:
    """No garbage is collected in the block; for work that makes many objects at once and keeps them until its end."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
