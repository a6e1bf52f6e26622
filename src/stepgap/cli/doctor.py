"""The verb `stepgap doctor`: the components that StepGap can use, and whether this machine has them."""

import os
import re
import sys
from collections import defaultdict
from collections.abc import Iterator

from stepgap.base.start_method import usable_cores
from stepgap.base.versions import INSTALL

PURPOSES = {
    "casadi": "stepgap export --to casadi",
    "cluster": "the option --dask of stepgap sweep",
    "ethercat": "robots with drives and encoders on an EtherCAT bus, and emulated rings",
    "gym": "the Gymnasium environment stepgap/Step-v0",
    "logs": "logs in Parquet, HDF5, MAT 7.3, ROS bags and MCAP with protobuf or ROS 2 messages",
    "moteus": "robots with mjbots moteus controllers on a CAN-FD bus",
    "onnx": "stepgap export --to onnx",
    "parquet": "stepgap export --to parquet, and the table of a sweep",
    "policy": "trained policies in ONNX files, stepgap new --policy",
}
"""Purposes of the extras."""

RENDERING_TRIAL = "import mujoco; mujoco.Renderer(mujoco.MjModel.from_xml_string('<mujoco/>'), 8, 8).close()"
"""Python code that succeeds where MuJoCo can render."""

REALTIME_TRIAL = "from stepgap.hardware.realtime.pace import ask_for_realtime; print('; '.join(ask_for_realtime()))"
"""Python code that prints the real-time rights that are refused."""

TRIAL_TIMEOUT = 30.0  # Longest time of a trial in another process [s]

NEEDS_GL = "needed only for MuJoCo's own pictures, not for runs, reports and their figures"


_Row = tuple[str, str]
"""Name of a component, and the result."""


def doctor() -> None:
    """Show what this machine has: versions, cores, graphics, rights for real time, the cache, extras."""
    rows = [*_versions(), *_machine(), *_graphics(), *_rights(), _cache(), *_extras()]
    width = max(len(name) for name, _ in rows)
    for name, result in rows:
        print(f"{name:{width}}  {result}")


def _versions() -> Iterator[_Row]:
    from stepgap.base.versions import versions_here

    yield from versions_here().items()


def _machine() -> Iterator[_Row]:
    import platform

    yield "system", platform.platform()
    yield "cores", f"{usable_cores()} of {os.cpu_count()}, load {os.getloadavg()[0]:.1f}"


def _graphics() -> Iterator[_Row]:
    display = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
    yield "display", display or f"none; {NEEDS_GL}"
    chosen = os.environ.get("MUJOCO_GL")
    backends = ["glfw", "egl", "osmesa"] if display else ["egl", "osmesa"]
    for backend in [chosen] if chosen else backends:
        if _try(RENDERING_TRIAL, MUJOCO_GL=backend) is not None:
            yield "OpenGL", f"works with MUJOCO_GL={backend}"
            return
    yield "OpenGL", f"none; {NEEDS_GL}. Debian, Ubuntu: apt install libegl1 libgl1 (or libosmesa6)"


def _rights() -> Iterator[_Row]:
    yield "raw sockets", _raw_sockets()
    refused = _try(REALTIME_TRIAL)
    yield "real time", "granted" if refused == "" else refused or "the trial failed"


def _raw_sockets() -> str:
    """Sentence on whether EtherCAT frames may be sent."""
    import socket

    if not hasattr(socket, "AF_PACKET"):
        return "not on this system; EtherCAT needs Linux"
    try:
        socket.socket(socket.AF_PACKET, socket.SOCK_RAW).close()
    except OSError as error:
        return f"{error.strerror}; EtherCAT needs root or CAP_NET_RAW (and CAP_NET_ADMIN for an emulated ring)"
    return "granted: EtherCAT can be used"


def _cache() -> _Row:
    from stepgap.base.compiled import cache_folder

    folder = cache_folder()
    if folder is None:
        return "cache", "no folder can be written: everything is compiled at every start; set NUMBA_CACHE_DIR"
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    return "cache", f"{folder}, {size / 2**20:.0f} MiB; it may be deleted; code is then compiled again when needed"


def _extras() -> Iterator[_Row]:
    """The optional packages of stepgap."""
    from importlib.metadata import requires

    packages_of_extra: dict[str, list[str]] = defaultdict(list)
    for requirement in requires("stepgap") or []:
        extra = re.search(r"extra == ['\"](.+?)['\"]", requirement)
        if extra:
            packages_of_extra[extra[1]].extend(_packages_of(requirement))
    for extra, packages in sorted(packages_of_extra.items()):
        versions = {package: _version(package) for package in packages}
        if missing := [package for package, number in versions.items() if number is None]:
            advice = f"to install it: {INSTALL} 'stepgap[{extra}]'"
            yield f"extra {extra}", f"missing ({', '.join(missing)}), for {PURPOSES[extra]}; {advice}"
        else:
            installed = ", ".join(f"{package} {number}" for package, number in versions.items())
            yield f"extra {extra}", f"installed ({installed}), for {PURPOSES[extra]}"


def _packages_of(requirement: str) -> Iterator[str]:
    """Name of a required package, and those of its own extra, such as `sysid` of `mujoco[sysid]`."""
    from importlib.metadata import PackageNotFoundError, requires

    match = re.match(r"([\w.-]+)(?:\[([\w.-]+)\])?", requirement)
    if match is None:
        return
    package, inner = match.groups()
    yield package
    try:
        further = (requires(package) or []) if inner else []
    except PackageNotFoundError:
        return
    for requirement in further:
        name = re.match(r"[\w.-]+", requirement)
        if name and re.search(rf"extra == ['\"]{inner}['\"]", requirement):
            yield name[0]


def _version(package: str) -> str | None:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _try(code: str, **environment: str) -> str | None:
    """Output of Python code in another process, because it may crash; None if it fails."""
    import subprocess

    try:
        outcome = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            timeout=TRIAL_TIMEOUT,
            env={**os.environ, **environment},
            check=False,
        )
    except subprocess.TimeoutExpired:
        return None
    return None if outcome.returncode else outcome.stdout.strip()
