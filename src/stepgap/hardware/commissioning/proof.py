"""Results of commissioning that torque requires: files beside rig.toml, each valid for exactly these settings."""

import json
import os
import platform
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path
from typing import Any

from stepgap.base.errors import InputError
from stepgap.base.files import read_bounded, write_whole
from stepgap.base.settings_file import LARGEST_SETTINGS_FILE

JOG = "jog"  # Verb of `stepgap rig`, and folder of its logs
LONGEST_AGE = timedelta(days=7)  # Time for which a result is valid


def proof_file(rig_file: Path, verb: str) -> Path:
    """Path of the result of a verb: `RIG.check.json` or `RIG.jog.json` next to `RIG.toml`."""
    return rig_file.with_suffix(f".{verb}.json")


def fingerprint(rig_file: Path) -> dict[str, str]:
    """Identifies the settings, the machine and the user for which a result is valid.

    Raises:
        InputError: The file cannot be read.
    """
    try:
        digest = sha256(rig_file.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{rig_file}: {error.strerror}; give an existing TOML file") from None
    user = str(os.getuid()) if hasattr(os, "getuid") else os.environ.get("USERNAME", "")
    return {"settings_sha256": digest, "host": platform.node(), "kernel": platform.release(), "user": user}


def write_proof(rig_file: Path, verb: str, mark: Mapping[str, str], content: Mapping[str, Any]) -> Path:
    """Writes a result next to the settings and returns its path.

    Args:
        verb: Verb of `stepgap rig` that found it.
        mark: `fingerprint` of the settings when they were read.
        content: The result; its `passed` states whether it permits torque.

    Raises:
        InputError: It cannot be written.
    """
    file = proof_file(rig_file, verb)
    date = datetime.now(UTC).isoformat(timespec="seconds")
    try:
        write_whole(
            file, json.dumps({"schema": 2, **mark, "date": date, **content}, indent=1, ensure_ascii=False) + "\n"
        )
    except OSError as error:
        raise InputError(f"{file}: cannot be written: {error.strerror}") from None
    return file


def proven(rig_file: Path, verb: str) -> dict[str, Any]:
    """Returns the result of a verb, if exactly these settings have passed it here within the last week.

    Raises:
        InputError: They have not; the message is one line with the remedy.
    """
    file = proof_file(rig_file, verb)
    remedy = f"run `stepgap rig {verb} {rig_file}` first"
    mark = fingerprint(rig_file)
    result = _read(file)
    if not result:
        raise InputError(f"{file}: there is no result of a {verb}; {remedy}")
    reasons = {
        "settings_sha256": f"the settings have changed since the {verb}",
        "host": f"the {verb} was done on another machine",
        "kernel": f"the {verb} was done with another kernel",
        "user": f"the {verb} was done by another user, who may have other privileges",
    }
    for key, reason in reasons.items():
        if result.get(key) != mark[key]:
            raise InputError(f"{file}: {reason}; {remedy}")
    if result.get("passed") is not True:
        raise InputError(f"{file}: the {verb} was not passed; remove the cause, then {remedy}")
    if not _is_recent(result.get("date")):
        raise InputError(f"{file}: the {verb} is older than {LONGEST_AGE.days} days; {remedy}")
    return result


def _is_recent(date: object) -> bool:
    """Whether a date as `write_proof` writes it lies within `LONGEST_AGE` before now."""
    try:
        age = datetime.now(UTC) - datetime.fromisoformat(str(date))
    except (ValueError, TypeError):
        return False
    return timedelta() <= age <= LONGEST_AGE


def _read(file: Path) -> dict[str, Any]:
    """Reads the content of a result; empty if there is none."""
    try:
        content = json.loads(read_bounded(file, LARGEST_SETTINGS_FILE))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}
