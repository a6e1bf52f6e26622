"""Whether machine and bus are fit for a robot: how late ticks begin, how many frames are lost, while nothing moves."""

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
"""Share of the ticks that must begin within half a tick."""

LEAST_SECONDS = 5.0
"""What must have been measured before a robot gets torque [s]."""

_ADVICE = (
    "what helps: nothing else at work on this machine; an rtprio and a memlock limit for you "
    "(/etc/security/limits.conf), or root; a kernel with PREEMPT_RT, or a core that is left alone (isolcpus); "
    "no power saving of the processor; no virtual machine"
)
BUS_ADVICE = (
    "see to cables and connectors; the interface must be wired to the robot alone, and no network manager may use it; "
    "a reply_timeout that is too short loses frames, too"
)


@dataclass(frozen=True)
class Timing:
    """How late ticks began.

    Attributes:
        ticks: How many.
        p50: Half of them began no later than this [s].
        p99: 99 % of them.
        p99_9: 99.9 % of them.
        worst: All of them.
        punctual: Share of those that began within half a tick.
        missed: Ticks that could not be made, since the one before them began whole ticks late.
        missed_in_a_row: The most of them without a punctual tick in between.
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
    """What was found.

    Attributes:
        tick: Time between two ticks [s].
        late_ticks: Ticks in a row that may be missed.
        timing: How late they began.
        lost_frames: Frames that did not come back in time.
        refused: What of its requests the kernel refused.
        fault: Why the measurement ended before its time; nothing else should be there.
    """

    tick: float
    late_ticks: int
    timing: Timing
    lost_frames: int
    refused: str
    fault: str

    def failures(self) -> list[str]:
        """What is not as it must be; nothing of a check that was passed."""
        timing, found = self.timing, []
        if timing.missed_in_a_row > self.late_ticks:
            found.append(f"{timing.missed_in_a_row} ticks in a row were missed, {self.late_ticks} may be")
        if timing.punctual < PUNCTUAL:
            found.append(
                f"{100 * timing.punctual:.2f} % of the ticks began within half a tick, {100 * PUNCTUAL:g} % must"
            )
        if self.fault:
            found.append(self.fault)
        return found


def timing_of(late: Array, tick: float) -> Timing:
    """How late ticks were.

    Args:
        late: By how much each began late [s]; shape (k,), at least one.
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
    """The most ticks missed in a row, as the safety function counts them: until one begins in time."""
    most = in_a_row = 0
    for count in missed:
        in_a_row = in_a_row + count if count else 0
        most = max(most, in_a_row)
    return most


def measure(setup: RealtimeSetup, frames: FrameCount, tick: float, late_ticks: int, seconds: float) -> Check:
    """Ticks a limp rig for a while.

    Args:
        setup: With that rig.
        frames: That its rig counts.
        tick: Its tick [s].
        late_ticks: Ticks in a row that may be missed.
        seconds: How long, in ticks.

    Raises:
        RigFault: There was not one tick.
    """
    ticks = ticks_of(setup, round(seconds / tick))
    return Check(tick, late_ticks, timing_of(ticks.column("late"), tick), frames.lost, ticks.refused, ticks.fault)


def describe(check: Check, bus: bool) -> str:
    """A table of what was found, the rule, and what follows.

    Args:
        check: What was found.
        bus: There was a bus, not only the machine.
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
    lines = [f"{name:19} {words}" for name, words in rows.items()]
    if failures:
        lines.append(_ADVICE)
    if failures and bus and (check.fault or check.lost_frames):
        lines.append(BUS_ADVICE)
    return "\n".join(lines)


def check_file(rig_file: Path) -> Path:
    """Where the result of a check stands: `RIG.check.json` beside `RIG.toml`."""
    return rig_file.with_suffix(".check.json")


def fingerprint(rig_file: Path) -> dict[str, str]:
    """What a check holds for: these settings on this machine.

    Raises:
        InputError: The file cannot be read.
    """
    try:
        digest = sha256(rig_file.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{rig_file}: {error.strerror}; give an existing TOML file") from None
    return {"settings_sha256": digest, "host": platform.node(), "kernel": platform.release()}


def write_check(rig_file: Path, mark: dict[str, str], check: Check) -> Path:
    """Writes the result beside the settings; its path.

    Args:
        rig_file: The settings.
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
    """Makes sure that exactly these settings have passed a check on this machine, with this kernel.

    Raises:
        InputError: They have not; the message is one line that says what to do.
    """
    file, again = check_file(rig_file), f"do `stepgap rig check {rig_file}` first"
    mark, found = fingerprint(rig_file), _read(file)
    if not found:
        raise InputError(f"{file}: no result of a check there; {again}")
    words = {
        "settings_sha256": "the settings have changed since",
        "host": "that was another machine",
        "kernel": "that was another kernel",
    }
    for key, said in words.items():
        if found.get(key) != mark[key]:
            raise InputError(f"{file}: {said}; {again}")
    if found.get("passed") is not True:
        raise InputError(f"{file}: the check was not passed; see what it says, then {again}")
    seconds = found.get("seconds")
    if not isinstance(seconds, float) or not seconds >= LEAST_SECONDS:
        raise InputError(f"{file}: it measured {seconds} s, less than {LEAST_SECONDS:g}; {again}")


def _read(file: Path) -> dict[str, Any]:
    """The content of a result; nothing where there is none."""
    try:
        with file.open("rb") as stream:
            content = json.loads(stream.read(LARGEST_SETTINGS_FILE))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}
