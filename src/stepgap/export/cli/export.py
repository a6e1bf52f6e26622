"""The verb `stepgap export`."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter, validators

from stepgap.base.errors import InputError
from stepgap.base.files import create, new_folder, own_folder
from stepgap.base.output_files import check_new, free_name, write_new, write_together, writing
from stepgap.base.versions import optional_package
from stepgap.cli.options import Integer, Name
from stepgap.cli.terminal import announces_compilation

if TYPE_CHECKING:
    from stepgap.experiment.settings import Experiment
    from stepgap.export.controller.portable_controller import PortableController

PACKAGE_OF_FORMAT = {"onnx": "onnx", "casadi": "casadi", "parquet": "pyarrow"}
"""Package that a format needs, which is looked for before a run is read."""

CONTROLLER_FILES = {
    "model": "model.json",
    "python": "controller.py",
    "onnx": "map.onnx",
    "casadi": "map.casadi",
    "fmu": "controller.fmu",
    "c": "controller.c",
}
"""Name of the file of each format of a learned controller; that of C has a header beside it."""


@announces_compilation
def export(
    folder: Path,
    /,
    *,
    to: Literal["mat", "csv", "parquet", "mcap", "foxglove", "mjcf", "model", "onnx", "casadi", "fmu", "c", "python"],
    iteration: Annotated[
        Integer | None, Parameter(name=("--deployment", "--iteration"), validator=validators.Number(gte=0))
    ] = None,
    name: Name = "",
    out: Path | None = None,
) -> None:
    """Convert a run for other programs: MATLAB, data frames, players of tick logs, viewers, controllers.

    Args:
        folder: Folder of the run.
        to: mat: all numbers, for MATLAB and Octave; csv, parquet: the steps; mcap: the ticks; foxglove: a layout with
            plots of the ticks; mjcf: the model of the hopper's twin; model: what was learned, as a documented JSON
            file; onnx, casadi: the corrected map; fmu: the controller for co-simulation; c: the
            controller as a C99 file and its header; python: the controller as a file that needs NumPy alone.
        iteration: Number of the only deployment to export. [default: all of them; for mcap the last one; for what was
            learned the one after the last]
        name: Name of this robot, such as its serial number, in the passport of what was learned. [default: that
            of the run]
        out: New file, or for mjcf a new folder. [default: a new one in the folder export/ of the run]
    """
    if to in PACKAGE_OF_FORMAT:
        optional_package(PACKAGE_OF_FORMAT[to], f"--to {to}", to)
    if to == "mjcf":
        _export_model(folder, iteration, out)
    elif to == "mcap":
        _export_ticks(folder, iteration, out)
    elif to == "foxglove":
        _export_layout(folder, iteration, out)
    elif to in CONTROLLER_FILES:
        _export_controller(folder, to, iteration, out, name)
    else:
        _export_steps(folder, to, iteration, out)


def _export_controller(folder: Path, to: str, iteration: int | None, out: Path | None, name: str) -> None:
    """Writes a learned controller; what was replaced for the export is printed as messages."""
    from stepgap.base.random_streams import random_stream
    from stepgap.experiment.run import load_run
    from stepgap.export.controller.portable_controller import portable_controller

    suffix = "" if to == "c" else _suffix(iteration)
    file = Path(CONTROLLER_FILES[to])
    target = _target(folder, f"{file.stem}{suffix}{file.suffix}", out)
    if to == "c":
        check_new(target.with_suffix(".h"), "--out")
        if target.suffix != ".c":
            raise InputError(f"--out {target}: the name must end with .c; the header beside it ends with .h")
    run = load_run(folder)
    controller = portable_controller(run, iteration, random_stream(run.needed(run.settings).seed, 0, 3), name)
    contents = _contents(controller, to, target)
    for sentence in (*controller.approximations, *controller.notes):
        print(sentence, file=sys.stderr)
    write_together(contents, "--out")


def _contents(controller: "PortableController", to: str, target: Path) -> dict[Path, str | bytes]:
    """Contents of the files by path; the stem of a C source begins the names of its functions."""
    from stepgap.export.controller.c_source import c_source
    from stepgap.export.controller.casadi_function import casadi_text
    from stepgap.export.controller.fmu import controller_fmu
    from stepgap.export.controller.model_document import model_document, model_text
    from stepgap.export.controller.onnx_model import onnx_model
    from stepgap.export.controller.python_source import python_source

    match to:
        case "c":
            source = c_source(controller, target.stem)
            return {target: source.code, target.with_suffix(".h"): source.header}
        case "fmu":
            return {target: controller_fmu(controller)}
        case "python":
            return {target: python_source(controller)}
        case "onnx":
            return {target: onnx_model(model_document(controller))}
        case "casadi":
            return {target: casadi_text(model_document(controller))}
        case _:
            return {target: model_text(controller)}


def _export_steps(folder: Path, to: str, iteration: int | None, out: Path | None) -> None:
    from stepgap.experiment.run import Run
    from stepgap.export.data.matlab import matlab_file
    from stepgap.export.data.text import columns_text, steps_text
    from stepgap.records.parquet_file import parquet_file
    from stepgap.records.step_columns import step_columns

    run = Run(folder).checked()
    columns = step_columns(run.recorded, iteration)
    name = "run" if to == "mat" else "steps"
    target = _target(folder, f"{name}{_suffix(iteration)}.{to}", out)
    if to == "csv":
        legend = target.with_stem(f"{target.stem}_columns")
        check_new(legend, "--out")
        write_together({target: steps_text(columns), legend: columns_text(columns)}, "--out")
    else:
        content = matlab_file(run, columns) if to == "mat" else parquet_file(columns)
        write_new(target, "--out", content)


def _export_ticks(folder: Path, iteration: int | None, out: Path | None) -> None:
    from stepgap.cli.progress import progress_bar
    from stepgap.experiment.replay import replay
    from stepgap.experiment.run import Run
    from stepgap.export.data.ticks import copy_ticks, write_ticks

    run = Run(folder).checked()
    if run.needed(run.settings).simulated:
        chosen = run.steps.iterations[-1] if iteration is None else iteration
        if out:
            check_new(out, "--out")
        with progress_bar("steps") as progress:
            ticks = replay(run, chosen, progress=progress)
        target = _target(folder, f"ticks{_suffix(chosen)}.mcap", out)
        write_ticks(ticks, target)
        print(target)
        return
    if iteration is not None:
        raise InputError("--deployment: not valid for the tick logs of a rig; leave this option out")
    logs = _logs_of_rig(folder)
    target = _target(folder, "ticks", out)
    with writing(target, "--out"):
        for line in copy_ticks(logs, target):
            print(line)


def _export_layout(folder: Path, iteration: int | None, out: Path | None) -> None:
    from stepgap.experiment.replay import tick_units_of
    from stepgap.export.data.foxglove import foxglove_layout
    from stepgap.export.data.ticks import logged_units

    if iteration is not None:
        raise InputError("--deployment: the layout is the same for all deployments; leave this option out")
    settings = _settings_of(folder)
    units = tick_units_of(settings) if settings.simulated else logged_units(_logs_of_rig(folder))
    write_new(_target(folder, "foxglove.json", out), "--out", foxglove_layout(units))


def _logs_of_rig(folder: Path) -> Path:
    """Folder of the tick logs of a rig's run, which contains at least one."""
    logs = own_folder(folder, "ticks")
    if not any(logs.glob("*.mcap")):
        raise InputError(f"{logs}: contains no .mcap file, so there are no ticks of this run")
    return logs


def _export_model(folder: Path, iteration: int | None, out: Path | None) -> None:
    from stepgap.experiment.loop import deployment_generator
    from stepgap.experiment.plants import simulation_of
    from stepgap.export.data.mjcf_files import mjcf_files
    from stepgap.robots.hopper.twin.simulation import HopperSimulation

    if iteration is not None:
        raise InputError("--deployment: the model is the same in all deployments; leave this option out")
    settings = _settings_of(folder)
    simulation = simulation_of(settings) if settings.simulated else None
    if not isinstance(simulation, HopperSimulation):
        raise InputError(f"robot '{settings.robot.name}', plant '{settings.plant}': only the hopper's twin is exported")
    _, twin = simulation.direct_rig(deployment_generator(settings.seed, 0))
    files = mjcf_files(twin, simulation.parameters.boom_length)
    target = _target(folder, "mjcf", out)
    with writing(target, "--out"), new_folder(target) as partial:
        for name, content in files.items():
            create(partial / name, content)
    for name in files:
        print(target / name)


def _settings_of(folder: Path) -> "Experiment":
    from stepgap.experiment.run import Run

    run = Run(folder)
    return run.needed(run.settings)


def _suffix(iteration: int | None) -> str:
    return "" if iteration is None else f"_{iteration}"


def _target(folder: Path, name: str, out: Path | None) -> Path:
    """Path of the output: the given one, or a free name in the run's folder."""
    if out:
        check_new(out, "--out")
        return out
    home = folder / "export"
    with writing(home, "--out"):
        home.mkdir(exist_ok=True)
    return free_name(home / name)
