"""Where an exception arose in the code of a plug-in, such as a user's robot."""

import traceback
from importlib.metadata import distributions
from importlib.util import find_spec
from pathlib import Path

ENTRY_POINTS = "stepgap."  # Beginning of the names of all groups of entry points that StepGap knows


def location_in_plugin(error: BaseException) -> str:
    """File and line of the innermost call in a plug-in of another package; empty if the exception arose without one."""
    roots = _roots()
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        file = Path(frame.filename)
        if any(file.is_relative_to(root) for root in roots):
            shown = file.relative_to(Path.cwd()) if file.is_relative_to(Path.cwd()) else file
            return f"{shown}, line {frame.lineno}"
    return ""


def _roots() -> list[Path]:
    """Modules and folders of the packages of all plug-ins but StepGap's own."""
    entries = (entry for distribution in distributions() for entry in distribution.entry_points)
    packages = {entry.module.partition(".")[0] for entry in entries if entry.group.startswith(ENTRY_POINTS)}
    roots: list[Path] = []
    for package in sorted(packages - {"stepgap"}):
        spec = find_spec(package)
        locations = spec and (spec.submodule_search_locations or ([spec.origin] if spec.origin else []))
        roots += map(Path, locations or [])
    return roots
