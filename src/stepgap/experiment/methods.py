"""The methods that a run can use: the default, the published one, and simple ones to compare them with.

A method is a named set of settings. So all of them make the same kind of run, with the same plant, rules and reports.
"""

from collections.abc import Mapping
from math import log
from typing import NamedTuple

from stepgap.control.settings import ControlSettings
from stepgap.learning.settings import LearningSettings

INTEGRAL_GAIN = 0.5
"""Part k of an error by which the method `integral` changes its correction."""

RLS_FORGETTING = 0.99
"""Factor of the weight of a step's error after every further step, in the method `rls`."""


class Method(NamedTuple):
    """A method.

    Attributes:
        learning: Settings of learning.
        control: Settings of step control.
        linear: Whether the nominal map is linearised (`nominal.linear`).
    """

    learning: LearningSettings
    control: ControlSettings = ControlSettings()
    linear: bool = False


def forgetting_time(factor: float) -> float:
    """Number of steps in which a weight falls to 1/e, if every step multiplies it by a factor between 0 and 1."""
    return -1 / log(factor)


METHODS: Mapping[str, Method] = {
    "default": Method(LearningSettings()),
    "paper": Method(
        LearningSettings(
            residual="fitrgp",
            lagged_inputs="none",
            early_stop=False,
            drift=False,
        ),
        ControlSettings(cautious=False, viability=False, avoid_failures=False, horizon=1),
    ),
    "integral": Method(
        LearningSettings(
            residual="constant",
            online=True,
            lagged_inputs="none",
            forgetting_time=forgetting_time(1 - INTEGRAL_GAIN),
            drift=False,
        )
    ),
    "rls": Method(
        LearningSettings(
            residual="linear",
            online=True,
            lagged_inputs="none",
            forgetting_time=forgetting_time(RLS_FORGETTING),
            drift=False,
        ),
        linear=True,
    ),
    "affine": Method(LearningSettings(residual="linear", lagged_inputs="none", drift=False), linear=True),
}
"""Values of `method`, which sets the tables `[learning]` and `[control]` and `nominal.linear` before single keys.

- `paper` is the method as published: MATLAB's `fitrgp`, Eq. 13 without further rules, four redeployments.
- `integral` adds a constant b to the nominal map, b ← b + k (actual − nominal − b) after every step: an integrator for
  each coordinate. b is the mean of the errors, in which an error counts less by the factor 1 − k after every step. So
  it is the residual `constant` with a forgetting time, updated online.
- `rls` is adaptive linear step-to-step dynamics next = A x + B u + c: A, B and c begin as those of the linearised
  nominal map, and are updated after every step by recursive least squares with exponential forgetting, in the sense of
  arXiv 2209.08458. It is the linearised map plus the residual `linear`, which is updated online. Its prior keeps its
  weight, so the estimate does not wind up where the steps do not excite it.
- `affine` is the same without forgetting and fitted between deployments: least squares with the linearised nominal map
  as the prior, inverted within the bounds of the command.
"""
