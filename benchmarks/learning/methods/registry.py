"""All methods of the learning benchmark by name."""

from functools import partial

from benchmarks.learning.learning_summary import UNCORRECTED, WITHOUT
from benchmarks.learning.methods import affine, physics
from benchmarks.learning.methods.ablation import ABLATIONS, ablated
from benchmarks.learning.methods.redeployment import EXPLORATION, corrected, from_the_first_hop, paper, residual
from benchmarks.learning.trial import UNCORRECTED_LEARNING, Method
from stepgap.experiment.settings import METHODS as RUN_METHODS
from stepgap.learning.entry_points import residual_models, residual_names
from stepgap.learning.settings import AUTO, LearningSettings

QUICK = ("linear", "posterior")
"""Names of the methods of a quick comparison."""

TEMPLATE_RESIDUALS = ("linear", "quadratic", "gp_on_linear", "posterior")
"""Residuals that are learned on top of the template."""

CLASSICAL: dict[str, Method] = {
    "integral": partial(corrected, settings=RUN_METHODS["integral"].learning),
    "identified": partial(physics.identified, settings=physics.LEARNING_ON),
    "identified_plain": partial(physics.identified, settings=UNCORRECTED_LEARNING),
    "identified_posterior": partial(physics.identified, settings=LearningSettings()),
    "rls": affine.rls,
}
"""Methods of control and identification; the identified models also without learning during the deployment."""

FROM_THE_FIRST_HOP: dict[str, Method] = {
    "online": partial(from_the_first_hop, settings=LearningSettings(online=True)),
    "exploring": partial(from_the_first_hop, settings=LearningSettings(exploration=EXPLORATION)),
    "exploring_online": partial(from_the_first_hop, settings=LearningSettings(online=True, exploration=EXPLORATION)),
}
"""Methods that learn during deployment 0, all with the default residual."""

TEMPLATE: dict[str, Method] = {
    "template_none": affine.template_uncorrected,
    **{f"template_{kind}": partial(affine.template_residual, kind=kind) for kind in TEMPLATE_RESIDUALS},
    "template_online": affine.template_online,
}
"""Methods whose nominal map is a template of four numbers."""


def methods() -> dict[str, Method]:
    """All methods by name, including every installed residual except `none`, which is deployment 0.

    Each can also be run without a rule, as METHOD-RULE: `method_of`.
    """
    kinds = (*(name for name in residual_names() if name != UNCORRECTED), AUTO)
    residuals: dict[str, Method] = {kind: partial(residual, kind=kind) for kind in kinds}
    return CLASSICAL | residuals | {"paper": paper} | FROM_THE_FIRST_HOP | TEMPLATE


def method_of(name: str) -> Method:
    """The method METHOD or METHOD-RULE; raises KeyError if there is none of this name."""
    full, without, rule = name.partition(WITHOUT)
    found = methods()[full]
    return partial(ablated, method=found, ablation=ABLATIONS[rule]) if without else found


def is_method(name: str) -> bool:
    """Whether there is a method of this name that can be used."""
    try:
        method_of(name)
    except KeyError:
        return False
    return True


def default_methods() -> list[str]:
    """Names of the methods that are compared by default; their residuals are the candidates of `auto`."""
    kinds = [model.name for model in residual_models() if model.candidate and model.name != UNCORRECTED]
    return [*CLASSICAL, *kinds, AUTO, "paper", *FROM_THE_FIRST_HOP, *TEMPLATE]
