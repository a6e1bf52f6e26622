"""Check of computer and bus before a robot gets torque: how late ticks begin and how many frames are lost."""

import json
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.files import write_whole
from stepgap.base.settings_file import LARGEST_SETTINGS_FILE
from stepgap.plants.commissioning.limp import ticks_of
from stepgap.plants.realtime.process import RealtimeSetup
from stepgap.rigs.limp_rig import FrameCount
from stepgap.step import Array

PUNCTUAL = 0.999
"""Fraction of the ticks that must begin within half a tick."""

LEAST_SECONDS = 5.0
"""Least duration of a measurement before a robot gets torque [s]."""

_ADVICE = (
    "remedies: no other load on this machine; an rtprio and a memlock limit for your user "
    "(/etc/security/limits.conf), or root; a kernel with PREEMPT_RT, or an isolated core (isolcpus); "
    "no power saving of the processor; no virtual machine"
)
BUS_ADVICE = (
    "check cables and connectors; the interface must be connected to the robot only, and no network manager may use "
    "it; frames are also lost if reply_timeout is too short"
)


@dataclass(frozen=True)
class Timing:
    """Statistics of the delays of ticks.

    Attributes:
        ticks: Number of ticks.
        p50: Median of the delays [s].
        p99: 99 % quantile [s].
        p99_9: 99.9 % quantile [s].
        worst: Largest delay [s].
        punctual: Fraction of the ticks that began within half a tick.
        missed: Number of ticks that were missed, since the one before them was late by more than a tick.
        missed_in_a_row: Largest number of consecutive missed ticks.
    """

    ticks: int
    p50: float
    p99: float
    p99_9: float
    worst: float
    punctual: float
    missed: int
    missed_in_a_row: int


@dataclass(frozen=True)
class Check:
    """Result of a check.

    Attributes:
        tick: Time between two ticks [s].
        late_ticks: Largest allowed number of consecutive missed ticks.
        timing: Statistics of the delays.
        lost_frames: Number of frames that did not come back in time.
        refused: The requests that the kernel refused; empty if there were none.
        fault: Why the measurement was aborted; empty if it was not.
    """

    tick: float
    late_ticks: int
    timing: Timing
    lost_frames: int
    refused: str
    fault: str

    def failures(self) -> list[str]:
        """Describes what is not within the limits; empty if the check is passed."""
        timing, found = self.timing, []
        if timing.missed_in_a_row > self.late_ticks:
            found.append(f"{timing.missed_in_a_row} ticks in a row were missed, at most {self.late_ticks} are allowed")
        if timing.punctual < PUNCTUAL:
            found.append(
                f"{100 * timing.punctual:.2f} % of the ticks began within half a tick, "
                f"at least {100 * PUNCTUAL:g} % are required"
            )
        if self.fault:
            found.append(self.fault)
        return found


def timing_of(late: Array, tick: float) -> Timing:
    """Computes the statistics of the delays of ticks.

    Args:
        late: Delay of each tick [s]; shape (k,), at least one.
        tick: Time between two of them [s].
    """
    missed = (late / tick).astype(int)
    p50, p99, p99_9 = np.quantile(late, (0.5, 0.99, 0.999)).tolist()
    return Timing(
        ticks=len(late),
        p50=p50,
        p99=p99,
        p99_9=p99_9,
        worst=float(late.max()),
        punctual=float(np.mean(late <= tick / 2)),
        missed=int(missed.sum()),
        missed_in_a_row=_longest(missed.tolist()),
    )


def _longest(missed: Sequence[int]) -> int:
    """Largest number of ticks missed in a row, as the safety function counts them: until one begins in time."""
    most = in_a_row = 0
    for count in missed:
        in_a_row = in_a_row + count if count else 0
        most = max(most, in_a_row)
    return most


def measure(setup: RealtimeSetup, frames: FrameCount, tick: float, late_ticks: int, seconds: float) -> Check:
    """Measures a rig without torque.

    Args:
        setup: Setup of that rig.
        frames: Count of the frames that it lost.
        tick: Its tick [s].
        late_ticks: Largest allowed number of consecutive missed ticks.
        seconds: Duration, rounded to ticks [s].

    Raises:
        RigFault: There was no tick at all.
    """
    ticks = ticks_of(setup, round(seconds / tick))
    return Check(tick, late_ticks, timing_of(ticks.column("late"), tick), frames.lost, ticks.refused, ticks.fault)


def describe(check: Check, bus: bool) -> str:
    """Formats a table of the result, the rule, and remedies.

    Args:
        check: The result.
        bus: Whether a bus was measured, not only the machine.
    """
    timing, failures = check.timing, check.failures()
    rule = f"at most {check.late_ticks} ticks missed in a row, {100 * PUNCTUAL:g} % within half a tick, no fault"
    rows = {
        "ticks": f"  {timing.ticks}, one every {1e6 * check.tick:g} µs",
        "late by   50 %": f"≤ {1e6 * timing.p50:.1f} µs",
        "          99 %": f"≤ {1e6 * timing.p99:.1f} µs",
        "          99.9 %": f"≤ {1e6 * timing.p99_9:.1f} µs",
        "          at most": f"  {1e6 * timing.worst:.1f} µs",
        "within half a tick": f"  {100 * timing.punctual:.3f} %",
        "ticks missed": f"  {timing.missed}, at most {timing.missed_in_a_row} in a row",
        "frames lost": f"  {check.lost_frames if bus else 'no bus was measured'}",
        "the kernel refused": f"  {check.refused or 'nothing'}",
        "rule": f"  {rule}",
        "result": "  passed" if not failures else f"  not passed: {'; '.join(failures)}",
    }
    lines = [f"{name:19} {text}" for name, text in rows.items()]
    if failures:
        lines.append(_ADVICE)
    if failures and bus and (check.fault or check.lost_frames):
        lines.append(BUS_ADVICE)
    return "\n".join(lines)


def check_file(rig_file: Path) -> Path:
    """Path of the result of a check: `RIG.check.json` next to `RIG.toml`."""
    return rig_file.with_suffix(".check.json")


def fingerprint(rig_file: Path) -> dict[str, str]:
    """Identifies the settings and the machine for which a check is valid.

    Raises:
        InputError: The file cannot be read.
    """
    try:
        digest = sha256(rig_file.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{rig_file}: {error.strerror}; give an existing TOML file") from None
    return {"settings_sha256": digest, "host": platform.node(), "kernel": platform.release()}


def write_check(rig_file: Path, mark: dict[str, str], check: Check) -> Path:
    """Writes the result next to the settings and returns its path.

    Args:
        rig_file: File of the settings.
        mark: Their `fingerprint` when they were read.
        check: The result.

    Raises:
        InputError: It cannot be written.
    """
    file, date = check_file(rig_file), datetime.now(UTC).isoformat(timespec="seconds")
    seconds = check.timing.ticks * check.tick
    content = {"schema": 1, **mark, "date": date, "passed": not check.failures(), "seconds": seconds, **asdict(check)}
    try:
        write_whole(file, json.dumps(content, indent=1, ensure_ascii=False) + "\n")
    except OSError as error:
        raise InputError(f"{file}: cannot be written: {error.strerror}") from None
    return file


def checked(rig_file: Path) -> None:
    """Ensures that exactly these settings have passed a check on this machine, with this kernel.

    Raises:
        InputError: They have not; the message is one line with the remedy.
    """
    file, remedy = check_file(rig_file), f"run `stepgap rig check {rig_file}` first"
    mark, found = fingerprint(rig_file), _read(file)
    if not found:
        raise InputError(f"{file}: there is no result of a check; {remedy}")
    reasons = {
        "settings_sha256": "the settings have changed since the check",
        "host": "the check was done on another machine",
        "kernel": "the check was done with another kernel",
    }
    for key, reason in reasons.items():
        if found.get(key) != mark[key]:
            raise InputError(f"{file}: {reason}; {remedy}")
    if found.get("passed") is not True:
        raise InputError(f"{file}: the check was not passed; remove the cause, then {remedy}")
    seconds = found.get("seconds")
    if not isinstance(seconds, float) or not seconds >= LEAST_SECONDS:
        raise InputError(f"{file}: the check measured {seconds} s, less than {LEAST_SECONDS:g}; {remedy}")


def _read(file: Path) -> dict[str, Any]:
    """Reads the content of a result; empty if there is none."""
    try:
        with file.open("rb") as stream:
            content = json.loads(stream.read(LARGEST_SETTINGS_FILE))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}
