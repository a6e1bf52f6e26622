"""Ticks as they are executed, for recorders and viewers."""

from collections.abc import Callable

import numpy as np

from stepgap.plants.compiled_rig import Rows
from stepgap.step import Array

OnTicks = Callable[[Rows, int], None]
"""Called with the rows of ticks at their end, some at a time, and the number of their step in the deployment.

Step 0 is what `Plant.start` does; step k is the k-th call of `Plant.take_step` after it.
"""


def numbered(rows: Rows, step: int) -> Array:
    """Rows of ticks with the number of their step as a further column; shape (k, fields + 1)."""
    ticks = np.asarray(rows, float)
    return np.column_stack([ticks, np.full(len(ticks), float(step))])


def thinned(on_ticks: OnTicks, every: int) -> OnTicks:
    """Function that passes the first tick and then every `every`-th one."""
    count = 0

    def on_all(rows: Rows, step: int) -> None:
        nonlocal count
        kept = rows[-count % every :: every]
        count += len(rows)
        if len(kept):
            on_ticks(kept, step)

    return on_all
