"""Recovery of the intact part of truncated or damaged records: a run folder, its `steps.csv`, or a tick log."""

from dataclasses import replace
from itertools import takewhile
from pathlib import Path

import numpy as np
from mcap.writer import MCAP0_MAGIC

from stepgap.base.errors import InputError, message_of
from stepgap.base.files import (
    create,
    new_file,
    new_folder,
    open_regular,
    read_bounded,
    read_bounded_text,
    write_whole,
)
from stepgap.base.json_data import parse_json
from stepgap.base.output_files import EXISTING_IS_COMPLETE
from stepgap.base.settings_file import read_toml
from stepgap.control.reference import read_reference
from stepgap.learning.steps import Steps
from stepgap.plants.ticks.tick_log import TickLogError, recover_ticks
from stepgap.records.model_files import model_path, read_model
from stepgap.records.steps_csv import LARGEST_STEPS_FILE, digest, read_step_log, recover_steps, space_of_header, text_of
from stepgap.records.summary import read_summary, write_summary
from stepgap.step import StepSpace

INPUT_FILES = (
    "reference.csv",
    "warm_start.csv",
    "prior.json",
    "priors/[!.]*.json",
    "nominal_map.json",
    "nominal_map.toml",
    "nominal_map.csv",
)
"""Files of a run folder, besides `experiment.toml`, that are written before the first step, as patterns."""


def recover_file(path: Path, out: Path) -> list[str]:
    """Writes the intact part of a file or of a run folder into a new one; the damaged one is not changed.

    Of a run folder its inputs, the intact steps, the intact models, and the summary of the deployments whose steps are
    all there are recovered, so that the new folder can be reported and, on a simulation, resumed.

    Returns:
        Messages that describe the faults and the number of recovered items.

    Raises:
        InputError: Nothing can be recovered, or `out` exists or cannot be written.
    """
    if path.is_dir() and not (path / "steps.csv").is_file():
        raise InputError(f"{path}: contains no steps.csv; give the folder of a run, a steps.csv or an .mcap file")
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise InputError(f"{path}: not a file; give the folder of a run, a steps.csv or an .mcap file")
    try:
        if path.is_dir():
            return _recover_run(path, out)
        return _recover_ticks(path, out) if _is_tick_log(path) else _recover_steps(path, out)
    except FileExistsError:
        raise InputError(f"{out}: exists already; choose another --out{EXISTING_IS_COMPLETE}") from None
    except OSError as error:
        raise InputError(f"{error.filename or path}: {error.strerror}") from None
    except (ValueError, TickLogError) as error:
        raise InputError(str(error)) from None


def _is_tick_log(path: Path) -> bool:
    with open_regular(path) as file:
        return path.suffix == ".mcap" or file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC


def _recover_ticks(path: Path, out: Path) -> list[str]:
    with new_file(out) as partial:
        ticks, faults = recover_ticks(path, partial)
    return [*(f"{path}: {fault}" for fault in faults), _counted(ticks, "tick", bool(faults))]


def _recover_run(folder: Path, out: Path) -> list[str]:
    steps, fault = _intact_steps(folder / "steps.csv")
    lines = [fault] if fault else []
    with new_folder(out) as partial:
        lines += _copy_inputs(folder, partial, steps.space)
        lines += _recover_models(folder, partial, steps) + _recover_summary(folder, partial, steps)
        write_whole(partial / "steps.csv", text_of(steps))
    return [*lines, _counted(len(steps), "step", bool(lines))]


def _copy_inputs(folder: Path, out: Path, space: StepSpace) -> list[str]:
    """Copies the inputs of a run as they are; returns the faults of those that are damaged."""
    inputs = [
        path for name in ("experiment.toml", *INPUT_FILES) for path in sorted(folder.glob(name)) if path.is_file()
    ]
    for path in inputs:
        write_whole(out / path.relative_to(folder), read_bounded(path, LARGEST_STEPS_FILE))
    return [f"{fault}; copied as it is" for path in inputs if (fault := _input_fault(path, space))]


def _input_fault(path: Path, space: StepSpace) -> str:
    """Why an input cannot be read, with its name; empty if it can."""
    try:
        if path.suffix == ".toml":
            read_toml(path, "a file that the run wrote")
        elif path.name == "reference.csv":
            read_reference(path, space)
        elif path.suffix == ".csv":
            read_step_log(path, space)
        else:
            parse_json(read_bounded_text(path, LARGEST_STEPS_FILE))
    except ValueError as error:
        return str(error) if str(path) in str(error) else f"{path}: {error}"
    return ""


def _recover_models(folder: Path, out: Path, steps: Steps) -> list[str]:
    """Copies the models of the recorded deployments that can be read; returns the faults of the others."""
    faults = []
    for iteration in steps.iterations:
        try:
            if read_model(folder, iteration, steps.space) is None:
                continue
            content = model_path(folder, iteration).read_bytes()
        except (ValueError, OSError) as error:
            faults.append(f"{message_of(error)}; left out")
        else:
            write_whole(model_path(out, iteration), content)
    return faults


def _recover_summary(folder: Path, out: Path, steps: Steps) -> list[str]:
    """Writes the summary of the first deployments that have all their steps; returns the fault of a damaged one."""
    names = steps.space.state_names
    try:
        summary = read_summary(folder / "summary.json", names)
    except (ValueError, OSError) as error:
        return [f"{message_of(error)}; left out"]
    planned = steps.planned()
    whole = takewhile(
        lambda deployment: len(planned.of_iteration(deployment.iteration)) == deployment.steps, summary.deployments
    )
    deployments = tuple(whole)
    if deployments:
        kept = steps.selected(np.isin(steps.iteration, [deployment.iteration for deployment in deployments]))
        measured = summary.noise_floor_measured and len(deployments) == len(summary.deployments)
        shorter = replace(summary, deployments=deployments, steps_sha256=digest(kept), noise_floor_measured=measured)
        write_summary(out / "summary.json", shorter, names)
    return []


def _intact_steps(path: Path) -> tuple[Steps, str]:
    """The steps before the first fault, at least one, and a message about it."""
    steps, fault = recover_steps(path, space_of_header(path))
    if not len(steps):
        raise InputError(f"{path}: it contains no complete step")
    return steps, fault


def _recover_steps(path: Path, out: Path) -> list[str]:
    steps, fault = _intact_steps(path)
    create(out, text_of(steps))
    return [*([fault] if fault else []), _counted(len(steps), "step", bool(fault))]


def _counted(count: int, noun: str, broken: bool) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'} {'recovered' if broken else 'copied: the file has no fault'}"
