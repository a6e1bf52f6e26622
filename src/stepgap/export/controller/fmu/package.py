"""Compiles and packs an exported controller as a Functional Mock-up Unit for co-simulation."""

import hashlib
import platform
import shutil
import subprocess
from collections.abc import Mapping
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from stepgap.base.errors import InputError
from stepgap.base.files import naming
from stepgap.export.controller.fmu.description import IDENTIFIER, FmiVersion, build_description, model_description
from stepgap.step import StepSpace

COMPILERS: Final = ("cc", "gcc", "clang")
"""Names of C compilers, in the order in which they are looked for."""

FLAGS: Final = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-ffp-contract=off")
"""Options of the compiler; only the functions of FMI are visible, so that units do not use each other's functions."""

PLATFORMS: Final = {
    ("Linux", "x86_64"): ("linux64", "x86_64-linux", ".so"),
    ("Linux", "aarch64"): ("aarch64-linux", "aarch64-linux", ".so"),
    ("Darwin", "x86_64"): ("darwin64", "x86_64-darwin", ".dylib"),
    ("Darwin", "arm64"): ("aarch64-darwin", "aarch64-darwin", ".dylib"),
}
"""Folder of the binary in FMI 2.0 and in 3.0, and its suffix, by system and processor."""

COMPILE_TIME: Final = 120.0
"""Longest time that the compiler may take [s]."""


def fmu_file(space: StepSpace, sources: Mapping[str, str], version: FmiVersion) -> bytes:
    """Content of an FMU; the same controller gives the same bytes, as far as the compiler does.

    Args:
        space: Names, units and ranges.
        sources: Texts of `controller.c` and `controller.h`, an exported controller with the prefix `controller`.
        version: Version of FMI.

    Raises:
        InputError: There is no C compiler, or none for this system.
    """
    texts = {**sources, **_own_sources(version)}
    token = _token(texts, version)
    texts["model.h"] = _header(space, token)
    two, three, suffix = _platform()
    binary = _compiled(texts, f"fmi{version}.c", suffix)
    contents = {
        "modelDescription.xml": model_description(space, version, token),
        f"binaries/{two if version == 2 else three}/{IDENTIFIER}{suffix}": binary,
        **{f"sources/{name}": text.encode() for name, text in sorted(texts.items())},
    }
    if version == 3:
        contents["sources/buildDescription.xml"] = build_description()
    return _zipped(contents)


def _own_sources(version: FmiVersion) -> dict[str, str]:
    here = files("stepgap.export.controller.fmu")
    return {name: here.joinpath(name).read_text("utf-8") for name in ("instance.h", f"fmi{version}.c")}


def _token(texts: Mapping[str, str], version: FmiVersion) -> str:
    """Text that differs for every controller."""
    parts = [str(version), *(f"{name}\n{text}" for name, text in sorted(texts.items()))]
    digest = hashlib.sha256("\n".join(parts).encode()).hexdigest()
    return f"{{{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:32]}}}"


def _header(space: StepSpace, token: str) -> str:
    state, command = (", ".join(map(repr, each.tolist())) for each in (space.state_centre, space.command_centre))
    return "\n".join([
        "/* Sizes and names of this controller. */",
        f"#define STATES {len(space.state)}",
        f"#define COMMANDS {len(space.command)}",
        f'#define TOKEN "{token}"',
        f"#define STATE_CENTRE {{{state}}}",
        f"#define COMMAND_CENTRE {{{command}}}",
        '#include "controller.h"',
        "",
    ])  # fmt: skip


def _platform() -> tuple[str, str, str]:
    key = (platform.system(), platform.machine())
    if key not in PLATFORMS:
        known = ", ".join(" on ".join(each) for each in PLATFORMS)
        raise InputError(f"--to fmu: cannot compile for {key[0]} on {key[1]}, only for {known}; use --to c")
    return PLATFORMS[key]


def _compiled(texts: Mapping[str, str], main: str, suffix: str) -> bytes:
    """The shared library of the sources."""
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        raise InputError(f"--to fmu needs a C compiler, one of {', '.join(COMPILERS)}; install one, or use --to c")
    with TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in texts.items():
            with naming(folder / file):
                (folder / file).write_text(text, "utf-8")
        target = folder / f"{IDENTIFIER}{suffix}"
        command = [compiler, *FLAGS, "-o", target.name, main, "controller.c"]
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


def _zipped(contents: Mapping[str, bytes]) -> bytes:
    stream = BytesIO()
    with ZipFile(stream, "w", ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(ZipInfo(name), content, ZIP_DEFLATED)
    return stream.getvalue()
