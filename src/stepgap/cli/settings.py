"""The verb `stepgap settings`."""

from pathlib import Path

from stepgap.cli.options import Overrides


def settings(experiment: Path | None = None, /, *, overrides: Overrides = None) -> None:
    """Print all settings with their values and meanings, as a TOML file of settings.

    Args:
        experiment: TOML file of settings. [default: the experiment of the paper]
    """
    from stepgap.experiment.settings import read_experiment
    from stepgap.experiment.settings_text import experiment_toml

    print(experiment_toml(read_experiment(experiment, overrides or [])), end="")
