"""The experiment of one case of a sweep, and its results."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from stepgap.base.files import naming
from stepgap.experiment.bands import executed_steps_to_band
from stepgap.experiment.inputs import load_reference
from stepgap.experiment.loop import run_experiment
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.plants import PlantRequest
from stepgap.experiment.run import Run
from stepgap.experiment.run_start import load_setup
from stepgap.experiment.settings import read_experiment
from stepgap.records.summary import Deployment, deployment_entry
from stepgap.sweep.cases.case_folder import checked_name
from stepgap.sweep.cases.plan import CaseOutput

_KEPT = {
    "runs": ("*.toml", "*.csv", "*.json", "models/*.json"),
    "steps": ("*.toml", "*.csv", "summary.json"),
    "nothing": (),
}
"""Patterns of the files to keep."""


def run_case(case: Mapping[str, Any]) -> CaseOutput:
    """Runs the experiment of a case in a temporary folder, without a measurement of the noise floor.

    Args:
        case: Texts of the experiment's `files` by name, and which files to `keep`.

    Returns:
        The deployments as in `summary.json`, with the steps to the band, and the files to keep.
    """
    with TemporaryDirectory(prefix="stepgap_") as name:
        folder = Path(name)
        for file, text in case["files"].items():
            path = folder / checked_name(file)
            with naming(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding="utf-8", newline="")
        settings = read_experiment(folder / "experiment.toml")
        reference = load_reference(settings, settings.space)
        setup = load_setup(PlantRequest(settings, reference, folder), load_nominal(settings).map)
        plants = setup.plants._replace(measure_noise_floor=None)
        deployments = run_experiment(replace(setup, plants=plants), folder)
        files = [file for pattern in _KEPT[case["keep"]] for file in sorted(folder.glob(pattern))]
        kept = {file.relative_to(folder).as_posix(): file.read_text(encoding="utf-8") for file in files}
        return CaseOutput(_entries(deployments, Run(folder)), kept)


def _entries(deployments: list[Deployment], run: Run) -> list[dict[str, Any]]:
    """Entries of the deployments, with the steps until the error stayed in the band, as known after each of them."""
    logs = [run.steps.of_iteration(deployment.iteration) for deployment in deployments]
    entries = []
    for count, deployment in enumerate(deployments, start=1):
        published = None if deployment.failed_steps else run.published
        steps = executed_steps_to_band(logs[:count], published.band) if published else None
        entries.append({**deployment_entry(deployment, run.space.state_names), "hops_to_band": steps})
    return entries
