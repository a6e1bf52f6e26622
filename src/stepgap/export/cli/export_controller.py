"""What `stepgap export` writes of a learned controller: the model file, the map for ONNX and CasADi, an FMU, C code."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, get_args

if TYPE_CHECKING:
    from stepgap.export.controller.portable_controller import PortableController

ControllerFormat = Literal["model", "python", "onnx", "casadi", "fmu"]
"""Formats of a learned controller."""

CONTROLLER_FILES: Final[dict[str, str]] = dict(
    zip(
        get_args(ControllerFormat),
        ("model.json", "controller.py", "map.onnx", "map.casadi", "controller.fmu"),
        strict=True,
    )
)
"""Name of the file of each format."""


def controller_file(
    folder: Path, to: str, deployment: int | None, fmi: Literal[2, 3] = 2, name: str = ""
) -> str | bytes:
    """Content of the file of a controller; what was replaced for the export is printed as messages.

    Args:
        folder: Folder of the run.
        to: A key of `CONTROLLER_FILES`.
        deployment: Number of the deployment; None for the one after the last.
        fmi: Version of FMI, for an FMU.
        name: Name of the robot in its passport.

    Raises:
        InputError: The run cannot be read or has no such deployment, or its controller has no portable form.
    """
    from stepgap.base.random_streams import random_stream
    from stepgap.experiment.run import load_run
    from stepgap.export.controller.portable_controller import portable_controller

    run = load_run(folder)
    controller = portable_controller(run, deployment, random_stream(run.needed(run.settings).seed, 0, 3), name)
    content = _content(controller, to, fmi)
    for sentence in (*map(str, controller.approximations), *controller.notes):
        print(sentence, file=sys.stderr)
    return content


def c_files(
    folder: Path, target: Path, deployment: int | None, real: Literal["double", "float"], name: str = ""
) -> dict[Path, str]:
    """Contents of the C source and of its header, by path; what was replaced is printed as messages.

    Args:
        folder: Folder of the run.
        target: Path of the C source; its stem begins the names of the functions.
        deployment: As of `controller_file`.
        real: Type of the numbers.
        name: As of `controller_file`.

    Raises:
        InputError: As of `controller_file`, or the name of the file is not a C identifier followed by `.c`.
    """
    from stepgap.base.errors import InputError
    from stepgap.base.random_streams import random_stream
    from stepgap.experiment.run import load_run
    from stepgap.export.controller.c_source import c_source
    from stepgap.export.controller.portable_controller import portable_controller

    if target.suffix != ".c":
        raise InputError(f"--out {target}: the name must end with .c; the header beside it ends with .h")
    run = load_run(folder)
    controller = portable_controller(run, deployment, random_stream(run.needed(run.settings).seed, 0, 3), name)
    source = c_source(controller, target.stem, real)
    for sentence in (*map(str, controller.approximations), *controller.notes):
        print(sentence, file=sys.stderr)
    return {target: source.code, target.with_suffix(".h"): source.header}


def _content(controller: "PortableController", to: str, fmi: Literal[2, 3]) -> str | bytes:
    from stepgap.export.controller.casadi_function import casadi_text
    from stepgap.export.controller.model_document import model_document, model_text
    from stepgap.export.controller.onnx_model import onnx_model
    from stepgap.export.controller.python_source import python_source

    if to == "fmu":
        from stepgap.export.controller.fmu.controller_fmu import controller_fmu

        return controller_fmu(controller, fmi)
    if to == "python":
        return python_source(controller)
    if to == "onnx":
        return onnx_model(model_document(controller))
    if to == "casadi":
        return casadi_text(model_document(controller))
    return model_text(controller)
