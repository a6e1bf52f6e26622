"""Check of computer and bus before a robot gets torque: late ticks, lost frames, privileges, and the watchdog."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from stepgap.base.errors import InputError
from stepgap.hardware.commissioning.limp import describe_devices, ticks_of
from stepgap.hardware.commissioning.proof import proof_file, proven, write_proof
from stepgap.hardware.realtime.pace import NEEDED_FOR_TORQUE
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.rigs.limits import RigLimits
from stepgap.rigs.rig import (
    CLOCK_DIFFERENCE,
    CLOCK_OFFSET,
    CLOCK_OUTSIDE,
    ClockLimits,
    Finding,
    Rig,
    RigFault,
    WatchdogTimes,
)
from stepgap.step import Array

USUAL = 0.999  # Fraction of the ticks whose frames must be within the usual distance
UNSETTLED = 500  # Number of ticks at the beginning in which frames and clocks approach their times; at most half of all

_LATE = (
    "frames are late if ticks are, or if the work of a tick varies: use a quieter machine; or choose a larger `tick` "
    "or fewer `frames_per_tick`, since the window is a share of the cycle"
)
_APART = (
    "its `assign_activate` may be wrong, so read its ESI file; lost frames disturb clocks, too, so check cables and "
    "connectors"
)


@dataclass(frozen=True)
class ClockCheck:
    """Distances of frames from their times on the reference clock of a bus, and of the slaves' clocks from it.

    Of several frames per tick, the one that is farthest from its time counts. The first `UNSETTLED` ticks count for
    `outside` only.

    Attributes:
        limits: What is allowed.
        ticks: Number of ticks with a known distance; without any, the others are zero.
        p50: Median of the distances [s].
        p99_9: 99.9 % quantile [s].
        worst: Largest distance [s].
        jitter: 99.9 % quantile of the change of the distance from tick to tick [s].
        outside: Largest number of consecutive frames outside of the window.
        differences: Largest difference of each slave's clock [s], by the name of the slave; None if it was never read.
    """

    limits: ClockLimits
    ticks: int = 0
    p50: float = 0.0
    p99_9: float = 0.0
    worst: float = 0.0
    jitter: float = 0.0
    outside: int = 0
    differences: Mapping[str, float | None] = field(default_factory=dict)

    def failures(self) -> list[str]:
        """Describes what is not within the limits, with remedies; empty if everything is."""
        if not self.ticks:
            return ["no frame reported its time on the reference clock"]
        limits = self.limits
        faults = []
        if self.p99_9 > limits.usual:
            faults.append(
                f"99.9 % of the frames were within {_micro(self.p99_9)} of their times on the reference clock, "
                f"but must be within {_micro(limits.usual)} (dc.usual): {_LATE}"
            )
        if self.outside > limits.outside:
            faults.append(
                f"{self.outside} frames in a row were outside of the window of {_micro(limits.window)}, "
                f"at most {limits.outside} are allowed (dc.outside): {_LATE}"
            )
        faults += [
            f"the clock of {slave} differed by {_micro(difference)} from the reference clock, at most "
            f"{_micro(limits.difference)} are allowed (dc.difference): {_APART}"
            for slave, difference in self.differences.items()
            if difference is not None and difference > limits.difference
        ]
        silent = [slave for slave, difference in self.differences.items() if difference is None]
        if silent:
            faults.append(
                f"{', '.join(silent)} never reported the difference of its clock (0x092C): measure for longer "
                "(--seconds), or check reply_timeout"
            )
        return faults

    def describe(self) -> str:
        """The result in one line."""
        measured = [difference for difference in self.differences.values() if difference is not None]
        apart = f"within {_micro(max(measured))}" if measured else "unknown"
        return (
            f"frames within {_micro(self.p99_9)} of their times (99.9 %), {_micro(self.worst)} at most, at most "
            f"{self.outside} in a row outside of the window; jitter {_micro(self.jitter)} (99.9 %); "
            f"slaves' clocks {apart}"
        )


def clock_check(ticks: TickTable, limits: ClockLimits | None) -> ClockCheck | None:
    """Computes how frames and clocks followed the reference clock; None without distributed clocks and their limits."""
    if limits is None or CLOCK_OFFSET not in ticks.units:
        return None
    settled = replace(ticks, rows=ticks.rows[min(UNSETTLED, len(ticks) // 2) :])
    offsets = settled[CLOCK_OFFSET]
    offsets = offsets[np.isfinite(offsets)]
    if not len(offsets):
        return ClockCheck(limits)
    distances = np.abs(offsets)
    changes = np.abs(np.diff(offsets))
    p50, p99_9 = np.quantile(distances, (0.5, USUAL)).tolist()
    return ClockCheck(
        limits=limits,
        ticks=len(offsets),
        p50=p50,
        p99_9=p99_9,
        worst=float(distances.max()),
        jitter=float(np.quantile(changes, USUAL)) if len(changes) else 0.0,
        outside=int(np.nanmax(ticks[CLOCK_OUTSIDE])),  # also at the beginning
        differences={
            name.removesuffix(f"_{CLOCK_DIFFERENCE}").replace("_", " "): _largest(settled[name])
            for name in ticks.units
            if name.endswith(CLOCK_DIFFERENCE)
        },
    )


def _largest(differences: Array) -> float | None:
    """Largest absolute difference; None if none is known."""
    amounts = np.abs(differences[np.isfinite(differences)])
    return float(amounts.max()) if len(amounts) else None


def _micro(time: float) -> str:
    return f"{1e6 * time:.1f} µs" if time >= 1e-7 else f"{1e6 * time:.3f} µs"


CHECK = "check"  # Verb of `stepgap rig`
PUNCTUAL = 0.999  # Fraction of the ticks that must begin within half a tick
LEAST_SECONDS = 5.0  # Least duration of a measurement before a robot gets torque [s]

WATCHDOG_MARGIN = 0.02
"""Time by which a measured watchdog may exceed its setting [s]; the measurement itself takes some of it."""

_WATCHDOG_ATTEMPTS = 3  # Number of measurements of the watchdog, of which the shortest counts: each is an upper bound

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
        simulated: The robot is a simulation: privileges and watchdog are reported, but not required.
        timing: Statistics of the delays.
        lost_frames: Number of frames that did not come back in time.
        refused: The requests that the kernel refused; empty if there were none.
        fault: Why the measurement was aborted; empty if it was not.
        watchdog: When the motors gave up their torque without messages; None if it was not measured.
        watchdog_fault: Why the watchdog is not proven; empty if it is, or if it was not measured.
        remarks: What a person should know about the rig, although it is no fault.
        contradictions: What documents of the devices say against the settings; empty if they agree.
        drives: Temperatures, bus voltages and states of STO and enable inputs at the end, by name.
        clock: Frames and clocks on the reference clock; None without distributed clocks.
    """

    tick: float
    late_ticks: int
    simulated: bool
    timing: Timing
    lost_frames: int
    refused: str
    fault: str
    watchdog: WatchdogTimes | None = None
    watchdog_fault: str = ""
    remarks: tuple[str, ...] = ()
    contradictions: tuple[str, ...] = ()
    drives: Mapping[str, str] = field(default_factory=dict)
    clock: ClockCheck | None = None

    def failures(self) -> list[str]:
        """Describes what is not within the limits; empty if the check is passed."""
        timing = self.timing
        faults = list(self.contradictions)
        if timing.missed_in_a_row > self.late_ticks:
            faults.append(f"{timing.missed_in_a_row} ticks in a row were missed, at most {self.late_ticks} are allowed")
        if timing.punctual < PUNCTUAL:
            faults.append(
                f"{100 * timing.punctual:.2f} % of the ticks began within half a tick, "
                f"at least {100 * PUNCTUAL:g} % are required"
            )
        if self.fault:
            faults.append(self.fault)
        if self.clock:
            faults += self.clock.failures()
        if not self.simulated:
            faults += [refusal for refusal in NEEDED_FOR_TORQUE if refusal in self.refused]
            faults += [self.watchdog_fault] if self.watchdog_fault else _slow_watchdogs(self.watchdog)
        return faults


def _slow_watchdogs(watchdog: WatchdogTimes | None) -> list[str]:
    """Describes the motors that kept their torque for too long."""
    if watchdog is None:
        return []
    return [
        f"{motor} kept its torque for {1e3 * time:.0f} ms without frames; its watchdog is {1e3 * watchdog.setting:g} ms"
        for motor, time in watchdog.measured.items()
        if time > watchdog.setting + WATCHDOG_MARGIN
    ]


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


def measure(
    setup: RealtimeSetup, tick: float, limits: RigLimits, seconds: float, clock_limits: ClockLimits | None = None
) -> Check:
    """Measures a rig without torque.

    Args:
        setup: Setup of that rig.
        tick: Its tick [s].
        seconds: Duration, rounded to ticks [s].
        clock_limits: Those of its reference clock; None without one.

    Raises:
        RigFault: There was no tick at all.
    """
    ticks = ticks_of(setup, round(seconds / tick))
    last = dict(zip(ticks.table.units, ticks.table.rows[-1].tolist(), strict=True))
    return Check(
        tick=tick,
        late_ticks=limits.late_ticks,
        simulated=limits.simulated,
        timing=timing_of(ticks.table["late"], tick),
        lost_frames=ticks.lost_frames,
        refused=ticks.refused,
        fault=ticks.fault,
        clock=clock_check(ticks.table, clock_limits),
        drives=describe_devices(setup.make_rig(), last),
    )


def with_watchdog(check: Check, make_rig: Callable[[], Rig]) -> Check:
    """Adds the proof of the watchdog: without torque, messages to the motors end, and the motors must notice it.

    Args:
        check: The result so far; if it has a fault, the rig is left alone.
    """
    if check.fault:
        return check
    remarks = tuple[str, ...]()
    findings = None
    shortest = None
    for _ in range(_WATCHDOG_ATTEMPTS):
        try:
            with make_rig() as rig:
                remarks = rig.remarks
                times = rig.watchdog_times()
                if findings is None:
                    findings = rig.findings()  # which takes time: when frames have ended
        except RigFault as fault:
            return replace(check, watchdog_fault=str(fault))
        if times and (shortest is None or _longest_time(times) < _longest_time(shortest)):
            shortest = times
        if not _slow_watchdogs(times):
            break
    return with_findings(replace(check, remarks=remarks, watchdog=shortest), findings or ())


def with_findings(check: Check, findings: Sequence[Finding]) -> Check:
    """Adds what documents of the devices say: contradictions are failures, doubts are remarks."""
    doubts = tuple(finding.text for finding in findings if not finding.is_error)
    contradictions = tuple(finding.text for finding in findings if finding.is_error)
    return replace(check, remarks=(*check.remarks, *doubts), contradictions=contradictions)


def _longest_time(watchdog: WatchdogTimes) -> float:
    return max(watchdog.measured.values())


def describe(check: Check, bus: bool) -> str:
    """Formats a table of the result, the rule, and remedies.

    Args:
        bus: Whether a bus was measured, not only the machine.
    """
    timing = check.timing
    failures = check.failures()
    rule = f"at most {check.late_ticks} ticks missed in a row, {100 * PUNCTUAL:g} % within half a tick, no fault"
    if check.simulated:
        rule += "; for a simulated robot (limits.simulated) neither privileges nor watchdog"
    else:
        rule += "; SCHED_FIFO and locked memory; watchdogs in time"
    if check.clock:
        limits = check.clock.limits
        rule += f"; frames within {1e6 * limits.usual:g} µs (99.9 %), clocks within {1e6 * limits.difference:g} µs"
    rows = {
        "ticks": f"  {timing.ticks}, one every {1e6 * check.tick:g} µs",
        "late by   50 %": f"≤ {1e6 * timing.p50:.1f} µs",
        "          99 %": f"≤ {1e6 * timing.p99:.1f} µs",
        "          99.9 %": f"≤ {1e6 * timing.p99_9:.1f} µs",
        "          at most": f"  {1e6 * timing.worst:.1f} µs",
        "within half a tick": f"  {100 * timing.punctual:.3f} %",
        "ticks missed": f"  {timing.missed}, at most {timing.missed_in_a_row} in a row",
        "reference clock": f"  {check.clock.describe() if check.clock else 'no distributed clocks'}",
        "frames lost": f"  {check.lost_frames if bus else 'no bus was measured'}",
        "the kernel refused": f"  {check.refused or 'nothing'}",
        "watchdog": f"  {_describe_watchdog(check)}",
        "drives": f"  {', '.join(f'{name} {text}' for name, text in check.drives.items()) or 'report nothing of this'}",
        "remarks": f"  {'; '.join(check.remarks) or 'none'}",
        "rule": f"  {rule}",
        "result": "  passed" if not failures else f"  not passed: {'; '.join(failures)}",
    }
    lines = [f"{name:19} {text}" for name, text in rows.items()]
    lines += [_ADVICE] if failures else []
    lines += [BUS_ADVICE] if failures and bus and (check.fault or check.lost_frames) else []
    return "\n".join(lines)


def _describe_watchdog(check: Check) -> str:
    if check.watchdog_fault:
        return check.watchdog_fault
    if check.watchdog is None:
        return "not measured"
    times = ", ".join(f"{motor} {1e3 * time:.0f} ms" for motor, time in check.watchdog.measured.items())
    return f"no torque after the last frame: {times} (setting {1e3 * check.watchdog.setting:g} ms)"


def write_check(rig_file: Path, mark: Mapping[str, str], check: Check) -> Path:
    """Writes the result next to the settings, with their `fingerprint` when they were read, and returns its path.

    Raises:
        InputError: It cannot be written.
    """
    seconds = check.timing.ticks * check.tick
    return write_proof(rig_file, CHECK, mark, {"passed": not check.failures(), "seconds": seconds, **asdict(check)})


def write_refusal(rig_file: Path, mark: Mapping[str, str], contradictions: Sequence[str]) -> Path:
    """Writes, as `write_check` does, that settings have not passed, because they contradict documents.

    Raises:
        InputError: It cannot be written.
    """
    return write_proof(rig_file, CHECK, mark, {"passed": False, "contradictions": list(contradictions)})


def checked(rig_file: Path) -> None:
    """Ensures that exactly these settings have passed a check on this machine, kernel and user within the last week.

    Raises:
        InputError: They have not; the message is one line with the remedy.
    """
    seconds = proven(rig_file, CHECK).get("seconds")
    if not isinstance(seconds, float) or not seconds >= LEAST_SECONDS:
        raise InputError(
            f"{proof_file(rig_file, CHECK)}: the check measured {seconds} s, less than {LEAST_SECONDS:g}; "
            f"run `stepgap rig check {rig_file}` first"
        )
