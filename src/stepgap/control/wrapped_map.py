"""Maps around another map, which is as uncertain as that one."""

from dataclasses import dataclass
from typing import final

from numpy.typing import ArrayLike

from stepgap.step import Array, Outcome, StepMap, StepSpace


@dataclass(frozen=True, eq=False)
class WrappedMap(StepMap):
    """A map with the uncertainty of another one; a subclass defines `space`, `evaluate` and `jacobian`.

    Attributes:
        inner: The other map.
    """

    inner: StepMap

    @property
    def noise_std(self) -> Array:
        """Standard deviation of a measured next state about its expected value; shape (n,)."""
        return self.inner.noise_std

    def std(self, state: ArrayLike, command: ArrayLike) -> Array:
        """Standard deviation of the next state; shape (…, n) [state units]."""
        return self.inner.std(state, command)

    def std_gradient(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂std/∂(state, command); shape (…, n, n + m)."""
        return self.inner.std_gradient(state, command)


@final
@dataclass(frozen=True, eq=False)
class MapInSpace(WrappedMap):
    """A map with other bounds of the commands, or other weights of the state; it predicts the same.

    Attributes:
        quantities: Names, units and ranges.
    """

    quantities: StepSpace

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self.quantities

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes of the map."""
        return self.inner.evaluate(state, command)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, n, n + m)."""
        return self.inner.jacobian(state, command)
