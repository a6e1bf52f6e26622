"""Methods without one of the rules of the default settings: METHOD-RULE is METHOD with that rule switched off.

The rule is off in all deployments that the method makes. Deployment 0 without correction, from which it may learn, is
the common one with all rules. What a method does without a learner and without `CautiousController` has no rules.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from benchmarks.learning.trial import Method, Trial
from stepgap.control.settings import ALL_RULES
from stepgap.learning.steps import Steps

LEARNING_RULES = ("drift",)
"""Rules that are fields of `LearningSettings`."""

CONTROL_RULES = ("cautious", "viability", "avoid_failures")
"""Rules that are fields of `ControlSettings`."""

PRIOR = "prior"
"""Name of the prior over robots, which is left out like a rule; only beliefs use it."""


@dataclass(frozen=True)
class Ablation:
    """A change of the settings of learning and of step control, by their names, and whether there is a prior."""

    learning: Mapping[str, bool] = field(default_factory=dict)
    control: Mapping[str, bool] = field(default_factory=dict)
    prior: bool = True


ABLATIONS = {
    **{rule: Ablation(learning={rule: False}) for rule in LEARNING_RULES},
    **{rule: Ablation(control={rule: False}) for rule in CONTROL_RULES},
    PRIOR: Ablation(prior=False),
    "all_rules": Ablation(dict.fromkeys(LEARNING_RULES, False), dict.fromkeys(CONTROL_RULES, False), prior=False),
}
"""Rules that can be switched off, by the name of their setting; and all of them together."""


def ablated(trial: Trial, method: Method, ablation: Ablation) -> Sequence[Steps]:
    """The deployments of a method without some rules."""
    control = replace(ALL_RULES, **ablation.control)
    priors = trial.priors if ablation.prior else ()
    return method(replace(trial, learning=ablation.learning, control=control, priors=priors))
