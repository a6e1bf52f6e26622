"""The user's settings of learning; they are apart from the models, which take time to import."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Final, get_type_hints

from stepgap.base.plugins import plugin_names, suggestion
from stepgap.base.ranges import require
from stepgap.base.settings_file import FORMER_NAME, as_type

RESIDUALS: Final = "stepgap.residuals"
"""Entry points of this group are residual models; their names are those of the setting `residual`."""

_LAGGED: Final = "gone, since beliefs know error and command of the step before; leave it out"

GONE_SETTINGS: Final[Mapping[str, str]] = {
    "learning.monitor": "gone, since beliefs compete by how probable they make the steps of the robot; leave it out",
    "learning.remove_yaw_dependence": "gone, since beliefs know what returns with the yaw; leave it out, or set "
    "learning.drift = false to learn between deployments only",
    "learning.reject_outliers": "gone, since a step counts as far as it was probably not disturbed; leave it out",
    "learning.feature_map": "gone, since feature maps did not lower the error; leave it out, and for a state of many "
    'numbers try learning.residual = "gp_on_linear"',
    "learning.lagged_inputs": _LAGGED,
    "learning.features": _LAGGED,
}
"""Dotted names of the settings of former versions, with what to write now, for users; recorded runs may have them."""

AUTO: Final = "auto"  # Name of the residual that selects the installed candidate with the best predictions


@dataclass(frozen=True)
class LearningSettings:
    """Settings of the residual model: its kind, its inputs, and when it is learned.

    Attributes:
        residual: Name of the installed residual model of the map's error from the first redeployment on, or `auto`;
            with `posterior`, beliefs are all that is learned, with another one they are about what it leaves.
        iterations: Redeployments at most; the first deployment, number 0, uses the nominal map, unless
            steps were known before.
        tolerance: Redeploying stops when the tracking error has not fallen by this fraction of the
            best so far; judged from the second redeployment on.
        forgetting_time: Number of steps in which the influence of a step falls to 1/e; for a Gaussian process, length
            scale of the time; inf: it never falls.
        early_stop: Whether redeploying stops before `iterations` when the error no longer falls.
        drift: Whether beliefs about the error follow the robot from step to step, also when it changes; without them
            the residual alone is learned.
        online: Whether to learn after every step, from the first one of deployment 0 on.
        exploration: Number of steps before the first deployment's tracking whose commands are the most informative;
            with a prior over robots fewer, if a further step would cost more than it saves.
    """

    residual: str = "posterior"
    iterations: int = 4
    tolerance: float = field(default=0.01, metadata={FORMER_NAME: "least_gain"})
    forgetting_time: float = field(default=inf, metadata={FORMER_NAME: "memory"})
    early_stop: bool = True
    drift: bool = True
    online: bool = False
    exploration: int = field(default=0, metadata={FORMER_NAME: "calibration"})

    def __post_init__(self) -> None:
        for name, kind in get_type_hints(type(self)).items():
            as_type(getattr(self, name), kind, name)
        _require_name("residual", self.residual, (AUTO, *plugin_names(RESIDUALS)))
        require(0 <= self.iterations <= 1000, "iterations", self.iterations, "lie between 0 and 1000")
        require(0 <= self.tolerance < 1, "tolerance", self.tolerance, "be at least 0 and less than 1")
        require(
            self.forgetting_time > 0, "forgetting_time", self.forgetting_time, "be a positive number of steps, or inf"
        )
        require(0 <= self.exploration <= 1000, "exploration", self.exploration, "lie between 0 and 1000")

    def learns_in(self, iteration: int) -> bool:
        """Whether steps of a deployment are learned from while it is running: all, or the exploratory ones."""
        return self.online or (iteration == 0 and self.exploration > 0)


def _require_name(setting: str, name: str, names: tuple[str, ...]) -> None:
    meant = suggestion(name, names)
    require(name in names, setting, name, f"be one of {', '.join(names)}{'; ' if meant else ''}{meant}")
