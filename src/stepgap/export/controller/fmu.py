"""A learned controller as a Functional Mock-up Unit, FMI 3.0 for co-simulation, with compiled C inside."""

import hashlib
import platform
import shutil
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, final
from xml.etree import ElementTree as ET
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from stepgap.base.errors import InputError
from stepgap.base.files import naming
from stepgap.base.versions import versions_here
from stepgap.export.controller.c_source import c_source
from stepgap.export.controller.portable_controller import PortableController
from stepgap.step import Quantity, StepSpace

COMPILERS: Final = ("cc", "gcc", "clang")  # Names of C compilers, in the order in which they are looked for

FLAGS: Final = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-ffp-contract=off")
"""Options of the compiler; only the functions of FMI are visible, so that units do not use each other's functions."""

PLATFORMS: Final = {
    ("Linux", "x86_64"): ("x86_64-linux", ".so"),
    ("Linux", "aarch64"): ("aarch64-linux", ".so"),
    ("Darwin", "x86_64"): ("x86_64-darwin", ".dylib"),
    ("Darwin", "arm64"): ("aarch64-darwin", ".dylib"),
}
"""Folder of the binary and its suffix, by system and processor."""

COMPILE_TIME: Final = 120.0  # Longest time that the compiler may take [s]
IDENTIFIER: Final = "stepgap_controller"  # Name of the model in its files
MAIN: Final = "fmi3.c"  # Source of the functions of FMI


def controller_fmu(controller: PortableController) -> bytes:
    """Content of an FMU that plans a step of the robot in each communication step.

    Raises:
        InputError: There is no C compiler, or none for this system.
    """
    source = c_source(controller, "controller")
    return fmu_file(controller.space, {"controller.h": source.header, "controller.c": source.code})


def fmu_file(space: StepSpace, sources: Mapping[str, str]) -> bytes:
    """Content of an FMU; the same controller gives the same bytes, as far as the compiler does.

    Args:
        space: Names, units and ranges.
        sources: Texts of `controller.c` and `controller.h`, an exported controller with the prefix `controller`.

    Raises:
        InputError: There is no C compiler, or none for this system.
    """
    texts = {**sources, MAIN: files("stepgap.export.controller").joinpath(MAIN).read_text("utf-8")}
    digest = hashlib.sha256("\n".join(f"{name}\n{text}" for name, text in sorted(texts.items())).encode()).hexdigest()
    token = f"{{{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:32]}}}"
    texts["model.h"] = _header(space, token)
    place, suffix = _platform()
    contents = {
        "modelDescription.xml": _model_description(space, token),
        f"binaries/{place}/{IDENTIFIER}{suffix}": _compiled(texts, suffix),
        **{f"sources/{name}": text.encode() for name, text in sorted(texts.items())},
        "sources/buildDescription.xml": _build_description(),
    }
    stream = BytesIO()
    with ZipFile(stream, "w", ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(ZipInfo(name), content, ZIP_DEFLATED)
    return stream.getvalue()


def _header(space: StepSpace, token: str) -> str:
    state, command = (", ".join(map(repr, centre.tolist())) for centre in (space.state_centre, space.command_centre))
    return f"""/* Sizes and names of this controller. */
#define STATES {len(space.state)}
#define COMMANDS {len(space.command)}
#define TOKEN "{token}"
#define STATE_CENTRE {{{state}}}
#define COMMAND_CENTRE {{{command}}}
#include "controller.h"
"""


def _platform() -> tuple[str, str]:
    key = (platform.system(), platform.machine())
    if key not in PLATFORMS:
        platforms = ", ".join(" on ".join(pair) for pair in PLATFORMS)
        raise InputError(f"--to fmu: cannot compile for {key[0]} on {key[1]}, only for {platforms}; use --to c")
    return PLATFORMS[key]


def _compiled(texts: Mapping[str, str], suffix: str) -> bytes:
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        raise InputError(f"--to fmu needs a C compiler, one of {', '.join(COMPILERS)}; install one, or use --to c")
    with TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in texts.items():
            with naming(folder / file):
                (folder / file).write_text(text, "utf-8")
        target = folder / f"{IDENTIFIER}{suffix}"
        command = [compiler, *FLAGS, "-o", target.name, MAIN, "controller.c", "-lm"]
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, timeout=COMPILE_TIME, check=False
            )
        except subprocess.TimeoutExpired:
            raise InputError(f"--to fmu: {compiler} took more than {COMPILE_TIME:.0f} s; use --to c") from None
        if done.returncode:
            reason = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[:200])
            raise InputError(f"--to fmu: {compiler} failed: {' '.join(reason.split())}; try another compiler as cc")
        return target.read_bytes()


@final
@dataclass(frozen=True)
class _Variable:
    """A variable; its value reference is its position in the list, which is that of fmi3.c."""

    name: str
    kind: str
    causality: str
    variability: str
    description: str
    start: str = ""
    unit: str = ""

    @property
    def attributes(self) -> dict[str, str]:
        """Those of its element of the model description."""
        optional = {
            "initial": "exact" if self.causality == "output" else "",
            "start": self.start,
            "unit": self.unit,
        }
        return {
            "name": self.name,
            "causality": self.causality,
            "variability": self.variability,
            "description": self.description,
            **{key: value for key, value in optional.items() if value},
        }


def _variables(space: StepSpace) -> list[_Variable]:
    """All variables, in the order of fmi3.c."""

    def group(name: str, quantities: Iterable[Quantity], causality: str, meaning: str, zero: bool) -> list[_Variable]:
        return [
            _Variable(
                f"{name}_{quantity.name}",
                "Float64",
                causality,
                "discrete",
                f"{meaning}: {quantity.name}",
                "0.0" if zero else repr((quantity.lower + quantity.upper) / 2),
                quantity.unit,
            )
            for quantity in quantities
        ]

    phase = f"Phase of {space.periodic.name}" if space.periodic else "Phase of a periodic context"
    completed = "The last command led to the present state"
    return [
        *group("state", space.state, "input", "Measured state at the section", zero=False),
        *group("target", space.state, "input", "State wanted at the next section", zero=False),
        _Variable(
            "phase", "Float64", "input", "discrete", f"{phase} at the section; used if phase_known", "0.0", "rad"
        ),
        *group("command", space.command, "output", "Command of the step", zero=False),
        *group("predicted", space.state, "output", "Predicted next state", zero=True),
        *group("std", space.state, "output", "Standard deviation of the next state as measured", zero=True),
        _Variable("result", "Int32", "output", "discrete", "0, or why no step was planned", "0"),
        _Variable("completed", "Boolean", "input", "discrete", completed, "true"),
        _Variable("phase_known", "Boolean", "parameter", "fixed", "The phase is measured", "false"),
        _Variable("time", "Float64", "independent", "continuous", "Time; a communication step is a step of the robot"),
    ]


def _model_description(space: StepSpace, token: str) -> bytes:
    """Content of `modelDescription.xml`; by the token the binary recognises its description."""
    variables = _variables(space)
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        instantiationToken=token,
        modelName="StepGap controller",
        generationTool=f"StepGap {versions_here()['stepgap']}",
        variableNamingConvention="flat",
    )
    abilities = ("canHandleVariableCommunicationStepSize", "canGetAndSetFMUState", "canSerializeFMUState")
    ET.SubElement(root, "CoSimulation", {"modelIdentifier": IDENTIFIER, **dict.fromkeys(abilities, "true")})
    units = ET.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(variable.unit for variable in variables if variable.unit):
        ET.SubElement(units, "Unit", name=unit)
    ET.SubElement(root, "DefaultExperiment", startTime="0", stepSize="1")
    listed = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        ET.SubElement(listed, variable.kind, {"valueReference": str(reference), **variable.attributes})
    # No output depends on an input before the next step.
    structure = ET.SubElement(root, "ModelStructure")
    for reference, variable in enumerate(variables):
        if variable.causality == "output":
            ET.SubElement(structure, "Output", valueReference=str(reference))
    return ET.tostring(root, "utf-8", xml_declaration=True)


def _build_description() -> bytes:
    """Content of `sources/buildDescription.xml`, by which the sources can be compiled elsewhere."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    build = ET.SubElement(root, "BuildConfiguration", modelIdentifier=IDENTIFIER)
    sources = ET.SubElement(build, "SourceFileSet", language="C99")
    for name in (MAIN, "controller.c"):
        ET.SubElement(sources, "SourceFile", name=name)
    ET.SubElement(build, "Library", name="m")
    return ET.tostring(root, "utf-8", xml_declaration=True)
