"""The experiment of one case of a sweep, and its results."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from stepgap.base.files import naming
from stepgap.experiment.bands import executed_steps_to_band
from stepgap.experiment.inputs import load_known, load_reference
from stepgap.experiment.loop import run_experiment
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.plants import PlantRequest, choose_plants
from stepgap.experiment.run_start import check_reach
from stepgap.experiment.settings import read_experiment
from stepgap.records.steps_csv import read_step_log
from stepgap.records.summary import Deployment, deployment_entry
from stepgap.robots.published_result import PublishedResult
from stepgap.step import StepSpace
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
                path.write_text(text, encoding="utf-8", newline="")
        settings = read_experiment(folder / "experiment.toml")
        nominal = load_nominal(settings).map
        reference, known = load_reference(settings, nominal.space), load_known(settings, nominal.space)
        check_reach(nominal, reference, Path(settings.reference).name)
        plants = choose_plants(PlantRequest(settings, reference, folder))
        run = partial(run_experiment, nominal, plants.make, reference, settings.learning, folder, settings.seed)
        deployments = run(known=known, control=settings.control)
        files = [file for pattern in _KEPT[case["keep"]] for file in sorted(folder.glob(pattern))]
        kept = {file.relative_to(folder).as_posix(): file.read_text(encoding="utf-8") for file in files}
        return CaseOutput(_entries(deployments, folder, nominal.space, settings.robot.published()), kept)


def _entries(
    deployments: list[Deployment], folder: Path, space: StepSpace, published: PublishedResult | None
) -> list[dict[str, Any]]:
    """Entries of the deployments, with the steps until the error stayed in the band, as known after each of them.

    Args:
        deployments: Finished deployments.
        folder: Folder of the run.
        space: State and command.
        published: Result whose error is the band; None if there is none.
    """
    steps = read_step_log(folder / "steps.csv", space)
    logs = [steps.of_iteration(deployment.iteration) for deployment in deployments]
    entries = []
    for count, deployment in enumerate(deployments, start=1):
        known = None if deployment.failed_steps else published
        hops = executed_steps_to_band(logs[:count], known.band) if known else None
        entries.append({**deployment_entry(deployment, space.state_names), "hops_to_band": hops})
    return entries
