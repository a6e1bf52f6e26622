"""Ticks as an array whose columns have names and units."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from stepgap.step import Array


@dataclass(frozen=True, eq=False)
class TickTable:
    """Ticks in the order in which they happened.

    Attributes:
        units: Unit of each column by its name, in their order.
        rows: One tick per row; shape (k, columns).
    """

    units: Mapping[str, str]
    rows: Array

    def __post_init__(self) -> None:
        if self.rows.ndim != 2 or self.rows.shape[1] != len(self.units):
            raise ValueError(f"rows must have {len(self.units)} columns, not the shape {self.rows.shape}")

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, name: str) -> Array:
        """One column; shape (k,)."""
        return self.rows[:, list(self.units).index(name)]

    def selected(self, names: Collection[str]) -> "TickTable":
        """Selects columns, in the order in which they are here."""
        kept = [name in names for name in self.units]
        return TickTable({name: unit for name, unit in self.units.items() if name in names}, self.rows[:, kept])

    def resampled(self, rate: float) -> "TickTable":
        """Selects ticks at a lower rate [1/s]: for each sampling time the first tick at or after it."""
        time = self["time"]
        samples = np.arange(time[0], time[-1], 1 / rate) - 1e-6  # times are rounded
        return TickTable(self.units, self.rows[np.searchsorted(time, samples)])
