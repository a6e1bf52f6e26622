"""The published result of a robot, with which runs along the same reference are compared."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from stepgap.control.reference import Reference
from stepgap.step import Array


@dataclass(frozen=True, eq=False)
class PublishedResult:
    """Tracking errors of a robot's hardware in a publication, next state − target, in SI units.

    Attributes:
        source: The publication in the middle of a sentence, such as "the paper".
        origin: Where its numbers are from, as the end of a sentence without a full stop.
        reference: The reference that was tracked; its names are those of the state.
        errors: Errors by deployment, 0 being that of the nominal map, and by measure of `summary.json`, as far as they
            were published; shape (n,). The first and the last deployment have an `rmse`.
        largest_std: Largest standard deviations of the learned map in the first and in the last redeployment; shape
            (n,) each. None if they were not published.
    """

    source: str
    origin: str
    reference: Reference
    errors: Mapping[int, Mapping[str, Array]]
    largest_std: tuple[Array, Array] | None = None

    def __post_init__(self) -> None:
        for number in (0, self.last):
            if "rmse" not in self.errors.get(number, {}):
                raise ValueError(f"errors have no rmse of deployment {number}; the first and the last need one")

    @property
    def last(self) -> int:
        """Number of the last deployment."""
        return max(self.errors, default=0)

    @property
    def band(self) -> Array:
        """RMSE of the last deployment, below which a run is as good as the published result; shape (n,)."""
        return self.errors[self.last]["rmse"]

    def error(self, measure: str, iteration: int, row: int) -> float | None:
        """Error of a state coordinate; None if it was not published.

        Args:
            measure: A measure of `summary.json`, such as `rmse`.
            row: Index of the state coordinate.
        """
        errors = self.errors.get(iteration, {})
        return float(errors[measure][row]) if measure in errors else None

    def is_tracked_by(self, targets: Array, complete: bool) -> bool:
        """Whether the targets of a deployment are those of the reference.

        Args:
            targets: Targets of its steps; shape (N, n).
            complete: Whether the deployment ended as planned; otherwise its targets may be fewer.
        """
        published = self.reference.targets
        is_long_enough = len(targets) == len(published) or not complete
        return is_long_enough and np.array_equal(targets, published[: len(targets)])
