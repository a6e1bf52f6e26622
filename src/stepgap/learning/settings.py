"""What a user says of learning; apart from the models themselves, which take time to import."""

from dataclasses import dataclass
from typing import Literal, get_args

GaussianProcessKind = Literal["gp", "fitrgp"]
"""Our Gaussian process, or the one that MATLAB's `fitrgp` would have given."""

ResidualKind = Literal["none"] | GaussianProcessKind
"""The models that `fit_residual` fits."""

KINDS: tuple[str, ...] = ("none", *get_args(GaussianProcessKind))
"""Their names."""


@dataclass(frozen=True)
class LearningSettings:
    """How often is learnt, and what.

    Attributes:
        residual: Model of the map's error from the first redeployment on.
        iterations: Redeployments at most; the first deployment, number 0, uses the nominal map.
        least_gain: Redeploying stops when the tracking error has not fallen by this fraction of the
            best so far; judged from the second redeployment on.
    """

    residual: ResidualKind = "gp"
    iterations: int = 4
    least_gain: float = 0.01

    def __post_init__(self) -> None:
        if self.residual not in KINDS:
            raise ValueError(f"residual = {self.residual!r}, but it must be one of {', '.join(KINDS)}")
        if not 0 <= self.iterations <= 1000:
            raise ValueError(f"iterations = {self.iterations}, but it must lie between 0 and 1000")
        if not 0 <= self.least_gain < 1:
            raise ValueError(f"least_gain = {self.least_gain}, but it must be at least 0 and less than 1")
