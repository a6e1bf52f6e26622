"""The nominal map of a verb: with progress while a simulator is sampled, and with warnings."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from stepgap.cli.terminal import warn

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.control.reference import Reference
    from stepgap.experiment.nominal import Nominal
    from stepgap.experiment.settings import Experiment
    from stepgap.step import Array


def nominal_with_progress(settings: "Experiment", reference: "Reference | None" = None) -> "Nominal":
    """The nominal map; says how far the fit of a surrogate has come, and what may be wrong with the map."""
    from stepgap.experiment.nominal import load_nominal, slowness

    def on_samples(count: int, error: "Array") -> None:
        errors = ", ".join(
            f"{quantity.name} {value:.2g} {quantity.unit}"
            for quantity, value in zip(settings.robot.space.state, error, strict=True)
        )
        print(f"nominal map: {count} simulated steps, error of the surrogate: {errors}", file=sys.stderr)

    nominal = load_nominal(settings, on_samples, reference)
    for sentence in (*nominal.warnings, slowness(settings.nominal.kind, nominal.map, settings.control.evaluations)):
        if sentence:
            warn(sentence)
    return nominal


def kept_surrogate(nominal: "Nominal") -> Path | None:
    """Writes a surrogate that was fitted now into a new file, so that it need not be fitted again.

    Returns:
        The file; None if there is no such surrogate, or no file can be written.
    """
    return _kept(Path("nominal_map.json"), nominal.file) if nominal.surrogate else None


def kept_reference(held: "Reference") -> Path | None:
    """Writes targets that are held into a new file; returns it, or None if no file can be written."""
    from stepgap.control.reference import reference_text

    return _kept(Path("held_reference.csv"), reference_text(held))


def _kept(path: Path, text: str) -> Path | None:
    from stepgap.base.files import create
    from stepgap.base.output_files import free_name

    free = free_name(path)
    try:
        create(free, text)
    except OSError:
        return None  # the reason why the verb ends is more important
    return free
