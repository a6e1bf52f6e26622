"""Results of the paper's hardware run (Krause, Alaeddini, Bhounsule, IDETC 2023), for comparison with a run.

Read off the plots of its Figs. 4 and 5, 227 steps per deployment; iteration 0 is its controller without a Gaussian
process. Errors are next state − target, speed in m/s and height in m.
"""

from collections.abc import Mapping
from typing import Final

STATE_NAMES: Final = ("speed", "height")
"""State of the paper's hopper at the apex (Sec. 4.2)."""

UNITS: Final[Mapping[str, str]] = {"speed": "m/s", "height": "m", "fx": "N", "fy": "N"}
"""Units of its state and its command (Sec. 4.2)."""

LAST_ITERATION: Final = 4
"""Its last redeployment, "4 hardware deployments" (Sec. 6)."""

NO_GP: Final[Mapping[str, Mapping[str, float]]] = {
    "rmse": {"speed": 0.0671, "height": 0.0193},
    "mae": {"speed": 0.0550, "height": 0.0186},
    "bias": {"speed": 0.0438, "height": -0.0186},
    "steady_rmse": {"speed": 0.0683, "height": 0.0199},
    "transient_rmse": {"speed": 0.0733, "height": 0.0198},
}
"""Errors of the controller without a GP: the dash-dotted red curves of Fig. 4, digitised, against its reference."""

WITH_GP: Final[Mapping[str, Mapping[str, float]]] = {
    "rmse": {"speed": 0.0179, "height": 0.0052},
    "mae": {"speed": 0.0111, "height": 0.0028},
    "bias": {"speed": 0.0004, "height": 0.0004},
    "steady_rmse": {"speed": 0.0107, "height": 0.0019},
    "transient_rmse": {"speed": 0.0277, "height": 0.0054},
}
"""Errors at iteration 4: the dashed black curves of Fig. 4, digitised, against its reference.

Steady is at least 4 steps after a change of the reference, transient the first 4 steps after each of its 18 changes.
"""

FIRST_STEPS_NO_GP: Final = (0.240, 0.243, 0.129)
FIRST_STEPS_WITH_GP: Final = (0.144, 0.111, 0.083)
"""Errors of speed on the first step after the three falls of the target speed, from Fig. 4, at iterations 0 and 4.

They make up 73 % of the sum of the squared transient errors that remained, and 55 % of that of all 227 errors.
"""

MAE_BY_ITERATION: Final[Mapping[str, tuple[float, ...]]] = {
    "speed": (0.0550, 0.109, 0.0141, 0.0102, 0.0111),
    "height": (0.0186, 0.0088, 0.0085, 0.0029, 0.0028),
}
"""Mean absolute error by iteration, from 0: iteration 0 from Fig. 4, 1 to 4 from Fig. 5.

Fig. 5 calls them "MSE"; they are taken for MAE because its last points equal the MAE of Fig. 4. The first
redeployment made the speed worse.
"""

LARGEST_STD: Final[Mapping[str, tuple[float, float]]] = {"speed": (0.03, 0.02), "height": (0.015, 0.01)}
"""Approximate largest standard deviation of the learned map at iterations 1 and 4 (Sec. 6, Figs. 6b and 7b)."""


def paper_error(measure: str, name: str, iteration: int) -> float | None:
    """Error of the paper's hardware run; None where the paper does not give it.

    Args:
        measure: A measure of `summary.json`, such as `rmse`; the true errors are not known.
        name: `speed` or `height`.
        iteration: Number of the iteration; 0 is the controller without a GP.
    """
    if measure == "mae" and 0 <= iteration <= LAST_ITERATION:
        return MAE_BY_ITERATION[name][iteration]
    table = {0: NO_GP, LAST_ITERATION: WITH_GP}.get(iteration)
    return table[measure][name] if table and measure in table else None
