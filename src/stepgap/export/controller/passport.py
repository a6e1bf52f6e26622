"""The passport of a robot: which individual it is, from what its controller was learned, and what that was good for."""

from collections.abc import Mapping
from datetime import UTC, datetime
from hashlib import sha256
from typing import Any

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.normal import std_interval_95
from stepgap.base.versions import versions_here
from stepgap.experiment.run import Run
from stepgap.experiment.settings import LONGEST_NAME
from stepgap.records.missing import Missing
from stepgap.step import Array


def passport_of(run: Run, deployment: int | None, name: str = "") -> dict[str, Any]:
    """The passport that an exported controller carries, as an object for JSON; docs/model_file.md has its keys.

    Args:
        run: The run in which it was learned.
        deployment: Number of the deployment that the controller begins; None for the one after the last.
        name: What the user calls this robot, such as its serial number; empty for the name of the run.

    Raises:
        InputError: The name is too long, or has letters that cannot be printed.
    """
    settings = run.needed(run.settings)
    log = run.recorded if deployment is None else run.recorded.before(deployment)
    file = run.settings_file
    changed = datetime.fromtimestamp((run.folder / "steps.csv").stat().st_mtime, UTC)
    return {
        "robot": settings.robot.name,
        "name": checked_robot_name(name or settings.name),
        "plant": settings.plant,
        "date": f"{changed:%Y-%m-%d}",
        "deployments": len(log.iterations),
        "steps": len(log),
        "errors": _errors(run),
        "settings_sha256": "" if isinstance(file, Missing) else sha256(file.text.encode()).hexdigest(),
        "versions": versions_here(),
    }


def checked_robot_name(name: str) -> str:
    """The name of a robot; raises InputError if it is too long, or has letters that cannot be printed."""
    if len(name) > LONGEST_NAME or not name.isprintable():
        raise InputError(f"name {name!r:.80}: must have at most {LONGEST_NAME} printable characters")
    return name


def passport_lines(passport: Mapping[str, Any]) -> list[str]:
    """The passport in words, for the head of a file; no line for none."""
    if not passport:
        return []
    name = f" '{passport['name']}'" if passport["name"] else ""
    errors = [
        f"{error['state']} {error['before']:.3g} to {error['after']:.3g} {error['unit']}"
        for error in passport["errors"]
        if error["before"] is not None and error["after"] is not None
    ]
    return [
        f"Robot {passport['robot']}{name}, plant {passport['plant']}, until {passport['date']}: learned from "
        f"{passport['steps']} steps of {passport['deployments']} deployments.",
        *([f"RMS error of the first and the last deployment: {', '.join(errors)}."] if errors else []),
        f"Settings {passport['settings_sha256'][:12] or 'unknown'}.",
    ]


def _errors(run: Run) -> list[dict[str, Any]]:
    """RMS tracking errors of the first and the last deployment, with the 95 % interval of the latter."""
    if not run.deployments:
        return []
    first = run.deployments[0]
    last = run.deployments[-1]
    ends = std_interval_95(last.rmse, max(last.steps, 1))
    return [
        {
            "state": quantity.name,
            "unit": quantity.unit,
            "before": _number(first.rmse[row]),
            "after": _number(last.rmse[row]),
            "after_interval": [_number(end) for end in ends[:, row]],
        }
        for row, quantity in enumerate(run.space.state)
        if quantity.weight
    ]


def _number(value: float | Array) -> float | None:
    return float(value) if np.isfinite(value) else None
