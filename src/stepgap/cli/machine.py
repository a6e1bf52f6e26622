"""What this machine has of all that StepGap can use, in a table: nothing here is needed by every user."""

import os
import platform
import re
import socket
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version

from stepgap.base.compiled import cache_folder
from stepgap.base.versions import versions_here

PURPOSES = {
    "ethercat": "robots with drives and encoders on an EtherCAT bus, and emulated rings",
    "gym": "the Gymnasium environment stepgap/Step-v0",
    "moteus": "robots with mjbots moteus controllers on a CAN-FD bus",
    "parquet": "stepgap export --to parquet",
    "sysid": "method sysid of stepgap bench learning",
}
"""What extras are for."""

RENDERS = "import mujoco; mujoco.Renderer(mujoco.MjModel.from_xml_string('<mujoco/>'), 8, 8).close()"
"""Ends well where MuJoCo can draw."""

ASKS = "from stepgap.plants.realtime.pace import ask_for_realtime; print('; '.join(ask_for_realtime()))"
"""Says what of real time is refused."""

PATIENCE = 30.0
"""Longest time for what is tried in a process of its own [s]."""

NEEDS_GL = "only MuJoCo's own pictures need it, not runs, reports and their figures"


def describe_machine() -> str:
    """A line for each thing: what it is, what was found, and what that means."""
    rows = [*_versions(), *_machine(), *_graphics(), *_rights(), _cache(), *_extras()]
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:{width}}  {found}" for name, found in rows)


Row = tuple[str, str]


def _versions() -> Iterator[Row]:
    yield from versions_here().items()


def _machine() -> Iterator[Row]:
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    yield "system", platform.platform()
    yield "cores", f"{usable} of {os.cpu_count()}, load {os.getloadavg()[0]:.1f}"


def _graphics() -> Iterator[Row]:
    shown = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
    yield "display", shown or f"none; {NEEDS_GL}"
    chosen = os.environ.get("MUJOCO_GL")
    for backend in [chosen] if chosen else ["glfw", "egl", "osmesa"] if shown else ["egl", "osmesa"]:
        if _tried(RENDERS, MUJOCO_GL=backend) is not None:
            yield "OpenGL", f"works with MUJOCO_GL={backend}"
            return
    yield "OpenGL", f"none; {NEEDS_GL}. Debian, Ubuntu: apt install libegl1 libgl1 (or libosmesa6)"


def _rights() -> Iterator[Row]:
    yield "raw sockets", _raw_sockets()
    refused = _tried(ASKS)
    yield "real time", "granted" if refused == "" else refused or "could not be tried"


def _raw_sockets() -> str:
    """Whether EtherCAT frames may be sent."""
    if not hasattr(socket, "AF_PACKET"):
        return "not on this system; EtherCAT needs Linux"
    try:
        socket.socket(socket.AF_PACKET, socket.SOCK_RAW).close()
    except OSError as error:
        return f"{error.strerror}; EtherCAT needs root or CAP_NET_RAW (and CAP_NET_ADMIN for an emulated ring)"
    return "granted: EtherCAT can be used"


def _cache() -> Row:
    folder = cache_folder()
    if folder is None:
        return "cache", "no folder can be written: everything is compiled at every start; set NUMBA_CACHE_DIR"
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    return "cache", f"{folder}, {size / 2**20:.0f} MiB; may be deleted, what is needed is compiled anew"


def _extras() -> Iterator[Row]:
    """The optional packages that stepgap names."""
    wanted: dict[str, list[str]] = defaultdict(list)
    for requirement in requires("stepgap") or []:
        name, extra = re.match(r"[\w.-]+", requirement), re.search(r"extra == ['\"](.+?)['\"]", requirement)
        if name and extra:
            wanted[extra[1]].append(name[0])
    for extra, packages in sorted(wanted.items()):
        found = [_version(package) for package in packages]
        missing = None in found
        there = ", ".join(f"{package} {number or '-'}" for package, number in zip(packages, found, strict=True))
        advice = f"; to have it: ./go uv pip install 'stepgap[{extra}]'" if missing else ""
        yield f"extra {extra}", f"{'missing' if missing else 'there'} ({there}), for {PURPOSES[extra]}{advice}"


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _tried(code: str, **environment: str) -> str | None:
    """What Python code prints in a process of its own, because it may crash; None if it fails."""
    try:
        outcome = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            env={**os.environ, **environment},
            check=False,
        )
    except subprocess.TimeoutExpired:
        return None
    return None if outcome.returncode else outcome.stdout.strip()
