"""What `stepgap report` adds to what a run folder holds: its settings understood, its map, and its replay."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stepgap.base.output_files import check_new, words_of, writing
from stepgap.experiment.plants import SIMULATED
from stepgap.experiment.replay import layout_of, logged_ticks, replay
from stepgap.experiment.settings import TWIN, Experiment, InputError, read_experiment
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.records.steps_csv import RecordError, digest
from stepgap.report import Background, RunRecord, comparison_html, read_run_folder, write_report
from stepgap.report.motion import RATE, Motion, Replay, read_motion, sensed_motion, write_motion
from stepgap.rigs.rig import RigLayout
from stepgap.robots.hopper.apex_map import ApexMap

EVERY = 1000 // RATE
"""One of so many ticks of a simulation, of which there are 1000 a second, is shown."""


NO_REPLAY = "There is no replay: "
"""How the sentence begins that stands for one."""


class Report(NamedTuple):
    """What became of a report.

    Attributes:
        path: Of the page.
        left_out: Parts that are missing, each with the reason in brackets.
    """

    path: Path
    left_out: tuple[str, ...]


def report_run(
    folder: Path,
    tell: Callable[[int, int], None] = lambda done, total: None,
    recorded: Mapping[int, TickTable] | None = None,
) -> Report:
    """Writes the report of a run with all that is known of it.

    The replay is kept in `replay/` of the run folder.

    Args:
        folder: The run folder.
        tell: Is told how many steps of how many are simulated, where motion has to be made again.
        recorded: Ticks of deployments, `RATE` a second, as a `TickRecorder` kept them while the run went on.

    Raises:
        InputError: A file of the run is not what it must be, or the report cannot be written.
    """
    try:
        record = read_run_folder(folder)
        background = _background(record, tell, recorded or {})
        return Report(write_report(folder, background=background), tuple(_left_out(record, background)))
    except (ValueError, OSError) as error:
        raise InputError(words_of(error)) from None


def _left_out(record: RunRecord, background: Background) -> list[str]:
    """What the page does without, and why."""
    folder, last, found = record.folder, record.shown[-1], []
    if not (folder / "steps.csv").read_bytes().endswith(b"\n"):
        found.append("the last line of steps.csv (it breaks off)")
    if not record.deployments:
        found.append("errors (no deployment is finished according to summary.json)")
    if last > 0 and not (folder / "models" / f"iteration_{last}.json").exists():
        found.append(f"what was learnt (no models/iteration_{last}.json)")
    if record.settings is None:
        return [*found, "settings, gait and replay (no experiment.toml)"]
    if isinstance(background.nominal, str):
        return [*found, "gait and replay (the settings are not understood, as the page says)"]
    if isinstance(background.replay, str):
        found.append(f"replay ({background.replay.removeprefix(NO_REPLAY).removesuffix('.')})")
    return found


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


def _background(record: RunRecord, tell: Callable[[int, int], None], recorded: Mapping[int, TickTable]) -> Background:
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
    return Background(plant, asdict(Experiment()), nominal, _replay(record, settings, tell, recorded))


def _replay(
    record: RunRecord, settings: Experiment, tell: Callable[[int, int], None], recorded: Mapping[int, TickTable]
) -> Replay | str:
    """Motions of the first and the last deployment, or why there are none."""

    def ticks_of(iteration: int) -> TickTable:
        if iteration in recorded:
            return recorded[iteration]
        if settings.plant in SIMULATED:
            return replay(record.folder, iteration, EVERY, tell)
        return _thinned(logged_ticks(record.folder, list(record.steps.of_iteration(iteration))))

    try:
        layout, motions = layout_of(settings), {}
        for iteration in dict.fromkeys((record.shown[0], record.shown[-1])):
            motions[iteration] = _motion(record, iteration, layout, ticks_of)
    except (InputError, RecordError) as error:
        return f"{NO_REPLAY}{error}."
    return Replay(motions, settings.robot, layout.pivot_height)


def _motion(record: RunRecord, iteration: int, layout: RigLayout, ticks_of: Callable[[int], TickTable]) -> Motion:
    """How a deployment moved: as kept in the folder, or from its ticks."""
    path = record.folder / "replay" / f"deployment_{iteration}.npz"
    steps = digest(record.steps.of_iteration(iteration))
    origin = sha256(f"sensed {RATE} {iteration} {steps} {record.settings}".encode()).hexdigest()
    kept = read_motion(path, origin)
    if kept is None:
        kept = sensed_motion(ticks_of(iteration), layout)
        write_motion(path, kept, origin)
    return kept


def _thinned(ticks: TickTable) -> TickTable:
    """So many of the ticks that `RATE` a second are left."""
    time = ticks["time"]
    wanted = np.arange(time[0], time[-1], 1 / RATE) - 1e-6  # times are rounded
    return TickTable(ticks.units, ticks.rows[np.searchsorted(time, wanted)])
