"""What a user says of learning; apart from the models themselves, which take time to import."""

from dataclasses import dataclass
from math import inf
from typing import Final, Literal, get_args

from stepgap.base.plugins import plugin_names, suggestion

RESIDUALS: Final = "stepgap.residuals"
"""Entry points of this group are residual models; their names are those of the setting `residual`."""

AUTO: Final = "auto"
"""The residual that takes whichever installed candidate predicts best."""

Features = Literal["none", "previous_error", "previous_step"]
"""What of the step before is an input: nothing, its error, or its error, applied command and state."""

FEATURES: tuple[Features, ...] = get_args(Features)
"""Their names."""


@dataclass(frozen=True)
class LearningSettings:
    """How often is learnt, and what.

    Attributes:
        residual: Name of the installed residual model of the map's error from the first redeployment on, or `auto`.
        iterations: Redeployments at most; the first deployment, number 0, uses the nominal map, unless
            steps were known before.
        least_gain: Redeploying stops when the tracking error has not fallen by this fraction of the
            best so far; judged from the second redeployment on.
        features: What of the step before the model takes as inputs, too; `auto`: what predicts best.
        memory: After how many steps what was learnt counts much less; inf: it counts for ever.
        drift: Whether a correction is shifted during a deployment by what it has left of late and at the same place,
            and what the place added to earlier deployments is not learnt.
        online: Whether to learn from hop to hop, from the very first one on.
        calibration: Hops before the first deployment's tracking whose commands are chosen for what they teach.
    """

    residual: str = "gp_on_linear"
    iterations: int = 4
    least_gain: float = 0.01
    features: Features | Literal["auto"] = "none"
    memory: float = inf
    drift: bool = True
    online: bool = False
    calibration: int = 0

    def __post_init__(self) -> None:
        if self.residual not in (names := (AUTO, *plugin_names(RESIDUALS))):
            meant = suggestion(self.residual, names)
            wanted = f"one of {', '.join(names)}{'; ' if meant else ''}{meant}"
            raise ValueError(f"residual = {self.residual!r}, but it must be {wanted}")
        if not 0 <= self.iterations <= 1000:
            raise ValueError(f"iterations = {self.iterations}, but it must lie between 0 and 1000")
        if not 0 <= self.least_gain < 1:
            raise ValueError(f"least_gain = {self.least_gain}, but it must be at least 0 and less than 1")
        if self.features not in (*FEATURES, "auto"):
            raise ValueError(f"features = {self.features!r}, but it must be one of {', '.join(FEATURES)}, auto")
        if not self.memory > 0:
            raise ValueError(f"memory = {self.memory}, but it must be a positive number of steps, or inf")
        if not 0 <= self.calibration <= 1000:
            raise ValueError(f"calibration = {self.calibration}, but it must lie between 0 and 1000")

    def steps_to_learn(self, iteration: int) -> float:
        """Number of steps of a deployment that are learnt from while it is running."""
        return inf if self.online else self.calibration if iteration == 0 else 0
