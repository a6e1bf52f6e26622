"""Residual models by name: those of this package and of others, found by their entry points."""

import warnings

from stepgap.base.errors import InputError, StepGapWarning
from stepgap.base.plugins import load_plugin, plugin_names
from stepgap.learning.regression import ResidualModel
from stepgap.learning.settings import AUTO, RESIDUALS


def residual_names() -> tuple[str, ...]:
    """Names of all installed residual models, in alphabetical order; imports none of them."""
    return plugin_names(RESIDUALS)


def load_residual_model(name: str) -> ResidualModel:
    """Loads a residual model by its name.

    Raises:
        InputError: There is no such model, a package that it needs is not installed, or it is not a residual model.
    """
    description = f"a {ResidualModel.__name__} of {ResidualModel.__module__}"
    model = load_plugin(RESIDUALS, "residual", name, lambda plugin: isinstance(plugin, ResidualModel), description)
    if model.name != name:
        raise InputError(f"residual '{name}': its model has the name '{model.name}'; both names must be the same")
    return model


def names_by_complexity() -> tuple[str, ...]:
    """Names of all installed residual models that can be used, from simple to complex; then `auto`."""
    return (*(model.name for model in residual_models()), AUTO)


def residual_models() -> list[ResidualModel]:
    """Loads all installed residual models, from simple to complex; a `StepGapWarning` names each that is unusable."""
    models: list[ResidualModel] = []
    for name in residual_names():
        try:
            models.append(load_residual_model(name))
        except InputError as error:
            warnings.warn(f"left out: {error}", StepGapWarning, stacklevel=1)
    return sorted(models, key=lambda model: (model.complexity, model.name))
