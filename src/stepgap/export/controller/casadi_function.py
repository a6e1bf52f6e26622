"""The corrected map as a function of CasADi, which differentiates it, built from the documented model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepgap.base.versions import optional_package
from stepgap.export.controller.formulas import corrections, nominal_state
from stepgap.export.controller.model_document import believed_regressions


def casadi_function(document: Mapping[str, Any]) -> Any:
    """The map (state, command) → (next_state, std) as a `casadi.Function`; its derivatives are those of CasADi.

    It has no failures: a step that would fail has the next state of the continued polynomial.

    Args:
        document: The model as `model_document` returns it.

    Raises:
        InputError: The package casadi is not installed.
    """
    casadi = optional_package("casadi", "--to casadi", "casadi")
    algebra = _CasADi(casadi)
    state, command = (casadi.MX.sym(key, len(document[key])) for key in ("state", "command"))
    point = casadi.vertcat(state, command).T
    parts = corrections(algebra, document["residual"]["regressions"], believed_regressions(document), point)
    mean, std = (casadi.vertcat(*column) for column in zip(*parts, strict=True))
    next_state = nominal_state(algebra, document["nominal"], point).T + mean
    names = ["state", "command"], ["next_state", "std"]
    return casadi.Function("stepgap_map", [state, command], [next_state, std], *names)


def casadi_text(document: Mapping[str, Any]) -> str:
    """Content of the file that `casadi.Function.load` reads; see `casadi_function`."""
    return casadi_function(document).serialize()


@final
@dataclass(frozen=True)
class _CasADi:
    """The `Algebra` of CasADi's matrices: rows of one step."""

    casadi: Any

    def constant(self, numbers: ArrayLike) -> Any:
        return self.casadi.DM(np.atleast_2d(np.asarray(numbers, float)))

    def exp(self, x: Any) -> Any:
        return self.casadi.exp(x)

    def cos(self, x: Any) -> Any:
        return self.casadi.cos(x)

    def sqrt(self, x: Any) -> Any:
        return self.casadi.sqrt(x)

    def clipped(self, x: Any, lower: float, upper: float) -> Any:
        return self.casadi.fmin(self.casadi.fmax(x, lower), upper)

    def joined(self, parts: Sequence[Any]) -> Any:
        return self.casadi.horzcat(*parts)

    def chosen(self, x: Any, columns: NDArray[np.int64]) -> Any:
        return x[:, columns.tolist()]

    def sum_of_squares(self, x: Any) -> Any:
        return self.casadi.sumsqr(x)

    def squared_distances(self, x: Any, centres: NDArray[np.float64]) -> Any:
        away = self.casadi.repmat(x, len(centres), 1) - self.constant(centres)
        return self.casadi.sum2(away**2).T
