"""Residual models and feature maps by name: those of this package and of others, found by their entry points."""

import warnings
from typing import TypeVar

from stepgap.base.errors import InputError, StepGapWarning
from stepgap.base.plugins import load_plugin, plugin_names
from stepgap.learning.feature_map import FeatureModel
from stepgap.learning.regression import ResidualModel
from stepgap.learning.settings import FEATURE_MAPS, RESIDUALS

_Model = TypeVar("_Model", ResidualModel, FeatureModel)


def residual_names() -> tuple[str, ...]:
    """Names of all installed residual models, in alphabetical order; imports none of them."""
    return plugin_names(RESIDUALS)


def load_residual_model(name: str) -> ResidualModel:
    """Loads a residual model by its name.

    Raises:
        InputError: There is no such model, a package that it needs is not installed, or it is not a residual model.
    """
    return _load(RESIDUALS, "residual", name, ResidualModel)


def load_feature_model(name: str) -> FeatureModel:
    """Loads a feature map's model by its name.

    Raises:
        InputError: There is no such model, a package that it needs is not installed, or it is not one of a feature map.
    """
    return _load(FEATURE_MAPS, "feature map", name, FeatureModel)


def _load(group: str, kind: str, name: str, wanted: type[_Model]) -> _Model:
    """Loads the model of this type that an entry point refers to; both must have the same name."""
    description = f"a {wanted.__name__} of {wanted.__module__}"
    model = load_plugin(group, kind, name, lambda found: isinstance(found, wanted), description)
    if model.name != name:
        raise InputError(f"{kind} '{name}': its model has the name '{model.name}'; both names must be the same")
    return model


def residual_models() -> list[ResidualModel]:
    """Loads all installed residual models, from simple to complex; a `StepGapWarning` names each that is unusable."""
    models: list[ResidualModel] = []
    for name in residual_names():
        try:
            models.append(load_residual_model(name))
        except InputError as error:
            warnings.warn(f"left out: {error}", StepGapWarning, stacklevel=1)
    return sorted(models, key=lambda model: (model.complexity, model.name))
