"""What `stepgap report` adds to what a run folder holds: its settings understood, its map, and its replay."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path

import numpy as np

from stepgap.experiment import TWIN, Experiment, InputError, read_experiment
from stepgap.hopper.apex_map import ApexMap
from stepgap.learning.step_log import RecordError, digest
from stepgap.new_files import check_new, words_of, writing
from stepgap.replay import replay
from stepgap.report import Background, RunRecord, comparison_html, read_run_folder, write_report
from stepgap.report.motion import RATE, Motion, Replay, read_motion, write_motion
from stepgap.run_plants import SIMULATED

CHANNELS = {
    "step": "step",
    "travel": "hip_x",
    "height": "hip_height",
    "alpha_1": "true_alpha_1",
    "alpha_2": "true_alpha_2",
    "force": "contact_force",
}
"""Channels of a motion, and what they are called among the ticks made again."""

TICKS_A_SECOND = 1000
"""Of a simulated plant."""


def report_run(folder: Path, tell: Callable[[int, int], None] = lambda done, total: None) -> Path:
    """Writes the report of a run with all that is known of it.

    The replay is simulated once and kept in `replay/` of the run folder.

    Args:
        folder: The run folder.
        tell: Is told how many steps of how many are simulated.

    Raises:
        InputError: A file of the run is not what it must be, or the report cannot be written.
    """
    try:
        record = read_run_folder(folder)
        return write_report(folder, background=_background(record, tell))
    except (ValueError, OSError) as error:
        raise InputError(words_of(error)) from None


def compare_runs(folders: Sequence[Path], page: Path) -> None:
    """Writes one page that compares several runs.

    Args:
        folders: Of the runs.
        page: File to write, which must not exist.

    Raises:
        InputError: A run cannot be read or compared, or the page cannot be written.
    """
    check_new(page, "--out")
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise InputError("a run is named twice; name each run once")
    try:
        text = comparison_html([read_run_folder(folder) for folder in folders])
    except (ValueError, OSError) as error:
        raise InputError(words_of(error)) from None
    with writing(page, "--out"), page.open("x", encoding="utf-8") as file:
        file.write(text)


def _background(record: RunRecord, tell: Callable[[int, int], None]) -> Background:
    """What the settings of a run tell; where they are not understood, why."""
    if record.settings is None:
        why = "The folder holds no experiment.toml"
        return Background("plant of an unknown kind", f"{why}.", f"{why}, so no gait.", f"{why}, so no replay.")
    try:
        settings = read_experiment(record.folder / "experiment.toml")
    except InputError as error:
        why = f"The settings are not understood here: {error}"
        return Background("plant of an unknown kind", why, f"{why}, so no gait.", f"{why}, so no replay.")
    plant = {TWIN: "simulated twin"}.get(settings.plant, f"plant '{settings.plant}'")
    nominal = ApexMap(settings.robot, settings.gains, settings.command)
    return Background(plant, asdict(Experiment()), nominal, _replay(record, settings, tell))


def _replay(record: RunRecord, settings: Experiment, tell: Callable[[int, int], None]) -> Replay | str:
    """Motions of the first and the last deployment, or why there are none."""
    if settings.plant not in SIMULATED:
        return (
            f"There is no replay: plant '{settings.plant}' is no simulation that could be made again. What it did, "
            "tick by tick, is in ticks/*.mcap of the run, which Foxglove and PlotJuggler open."
        )
    motions = {}
    for iteration in dict.fromkeys((record.shown[0], record.shown[-1])):
        try:
            motions[iteration] = _motion(record, iteration, tell)
        except (InputError, RecordError) as error:
            return f"There is no replay: {error}."
    return Replay(motions, settings.robot, settings.gap.boom_pivot_height)


def _motion(record: RunRecord, iteration: int, tell: Callable[[int, int], None]) -> Motion:
    """How a deployment moved: as kept in the folder, or simulated again."""
    path = record.folder / "replay" / f"deployment_{iteration}.npz"
    steps = digest(record.steps.of_iteration(iteration))
    origin = sha256(f"{RATE} {iteration} {steps} {record.settings}".encode()).hexdigest()
    kept = read_motion(path, origin)
    if kept is not None:
        return kept
    ticks = replay(record.folder, iteration, TICKS_A_SECOND // RATE, tell)
    channels = {name: ticks[column].astype(np.float32).astype(float) for name, column in CHANNELS.items()}
    motion = Motion(**channels)  # rounded as it is kept, so that the page is the same however the motion was had
    write_motion(path, motion, origin)
    return motion
