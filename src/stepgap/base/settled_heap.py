"""The garbage collector and what a program needs until its end."""

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
