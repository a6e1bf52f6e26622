"""Reference and results of the paper's hardware run (Krause, Alaeddini, Bhounsule, IDETC 2023).

Read off the plots of its Figs. 4 and 5, 227 steps per deployment; iteration 0 is its controller without a Gaussian
process. Errors are next state − target, speed in m/s and height in m.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from stepgap.control.reference import Reference
from stepgap.robots.published_result import PublishedResult

STATE_NAMES: Final = ("speed", "height")  # State of the paper's hopper at the apex (Sec. 4.2).

PAPER_STEPS = 227
PAPER_START = (0.0, 0.55)
PAPER_STAIR = (0.17, 0.2255, 0.281, 0.3365, 0.392)
PAPER_FLOORS = (
    (0.58, (20, 31, 43, 55, 67)),
    (0.5963, (79, 91, 103, 115, 127)),
    (0.6126, (139, 151, 163, 175, 187)),
    (0.629, (199, 211, 223)),
)
"""Apex heights [m], each with the steps, counted from 1, at which the speeds of `PAPER_STAIR` [m/s] begin."""

LAST_ITERATION: Final = 4  # Its last redeployment, "4 hardware deployments" (Sec. 6).

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


def paper_reference() -> Reference:
    """The 227 targets of the paper's experiment (Fig. 4): four apex heights, with a staircase of speeds at each."""
    segments = [(1, PAPER_START)]
    for height, starts in PAPER_FLOORS:
        segments += [(start, (speed, height)) for start, speed in zip(starts, PAPER_STAIR, strict=False)]
    return Reference.from_segments(("speed", "height"), segments, PAPER_STEPS)


def paper_result() -> PublishedResult:
    """Errors of the paper's hardware along its reference; the true errors are not known."""
    mae = zip(*(MAE_BY_ITERATION[name] for name in STATE_NAMES), strict=True)
    errors = {iteration: {"mae": np.array(both)} for iteration, both in enumerate(mae)}
    for iteration, table in ((0, NO_GP), (LAST_ITERATION, WITH_GP)):
        rows = table.items()
        errors[iteration] = {measure: np.array([row[name] for name in STATE_NAMES]) for measure, row in rows}
    first_std, last_std = np.transpose([LARGEST_STD[name] for name in STATE_NAMES])
    return PublishedResult(
        source="the paper",
        origin=f"{PAPER_STEPS} steps per deployment, read off its Figs. 4 and 5",
        reference=paper_reference(),
        errors=errors,
        largest_std=(first_std, last_std),
    )
