"""The result of a check, and the settings and machine for which it is valid."""

import json
import os
import platform
from contextlib import nullcontext
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.base.errors import InputError
from stepgap.hardware.commissioning.check import (
    Check,
    ClockCheck,
    Timing,
    checked,
    describe,
    timing_of,
    with_findings,
    with_watchdog,
    write_check,
)
from stepgap.hardware.commissioning.proof import fingerprint, proof_file
from stepgap.hardware.hopper.still import StillRig
from stepgap.hardware.realtime.pace import NO_LOCKED_MEMORY, NO_PRIORITY
from stepgap.rigs.rig import ClockLimits, Finding, RigFault, SensorModel, WatchdogTimes

TICK = 1e-3
GOOD = Check(
    tick=TICK,
    late_ticks=2,
    simulated=False,
    timing=Timing(5000, 1e-6, 2e-6, 3e-6, 4e-6, 1.0, 0, 0),
    lost_frames=0,
    refused="",
    fault="",
)
late_by = st.lists(st.floats(0, 5e-3) | st.sampled_from([0.0, 0.5e-3, 1e-3, 2.5e-3]), min_size=1, max_size=300)


@settings(deadline=None)
@given(late_by)
def test_timing_is_that_of_the_ticks(late: list[float]) -> None:
    timing = timing_of(np.array(late), TICK)
    ordered = sorted(late)
    assert (timing.ticks, timing.worst) == (len(late), ordered[-1])
    assert timing.p50 <= timing.p99 <= timing.p99_9 <= timing.worst
    for share, found in ((0.5, timing.p50), (0.99, timing.p99), (0.999, timing.p99_9)):
        rank = share * (len(late) - 1)
        assert ordered[int(rank)] <= found + 1e-15
        assert found <= ordered[int(np.ceil(rank))] + 1e-15
    assert timing.punctual == sum(each <= TICK / 2 for each in late) / len(late)
    runs = "".join(chr(min(9, int(each / TICK)) + ord("0")) for each in late).split("0")
    assert timing.missed_in_a_row == max(sum(map(int, run)) for run in runs)
    assert timing.missed == sum(sum(map(int, run)) for run in runs)


@pytest.mark.parametrize(
    ("timing", "fault", "expected"),
    [
        ({}, "", ""),
        ({"missed": 9, "missed_in_a_row": 2}, "", ""),
        ({"missed": 9, "missed_in_a_row": 3}, "", "3 ticks in a row were missed, at most 2 are allowed"),
        ({"punctual": 0.999}, "", ""),
        ({"punctual": 0.998}, "", "99.80 % of the ticks began within half a tick, at least 99.9 % are required"),
        ({}, "3 frames in a row were lost", "3 frames in a row were lost"),
    ],
)
def test_the_rule(timing: dict[str, float], fault: str, expected: str) -> None:
    check = replace(GOOD, timing=replace(GOOD.timing, **timing), fault=fault)
    assert "; ".join(check.failures()) == expected
    text = describe(check, bus=True)
    assert ("not passed" in text) == bool(expected)
    assert ("PREEMPT_RT" in text) == bool(expected), "remedies are given"
    assert expected in text


def test_what_the_drives_report_is_described() -> None:
    assert "drives                report nothing of this" in describe(GOOD, bus=True)
    check = replace(GOOD, drives={"motor_1_temperature": "31.0 °C", "motor_1_sto": "closed"})
    assert "drives                motor_1_temperature 31.0 °C, motor_1_sto closed\n" in describe(check, bus=True)


IN_TIME = WatchdogTimes(0.05, {"drive_1": 0.051, "drive_2": 0.069})
TOO_SLOW = WatchdogTimes(0.05, {"drive_1": 0.051, "drive_2": 0.071})


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        ({"watchdog": IN_TIME}, ""),
        ({"watchdog": TOO_SLOW}, "drive_2 kept its torque for 71 ms without frames; its watchdog is 50 ms"),
        ({"watchdog_fault": "drive_1 accepts torque"}, "drive_1 accepts torque"),
        ({"refused": f"{NO_PRIORITY}; the isolated core 3 is refused"}, NO_PRIORITY),
        ({"refused": NO_LOCKED_MEMORY}, NO_LOCKED_MEMORY),
        ({"refused": "the isolated core 3 is refused"}, ""),
    ],
)
def test_privileges_and_watchdog_are_required_of_a_real_robot_only(found: dict[str, Any], expected: str) -> None:
    check = replace(GOOD, **found)
    assert "; ".join(check.failures()) == expected
    assert expected in describe(check, bus=True)
    assert not replace(check, simulated=True).failures()


class WatchedRig(StillRig):
    """A rig whose watchdog is measured with given results, one after the other; a text is a fault."""

    def __init__(self, found: list[WatchdogTimes | str | None]):
        super().__init__(SensorModel(tick=TICK), ())
        self.found, self.closed, self.documents_read = found, 0, 0

    def watchdog_times(self) -> WatchdogTimes | None:
        result = self.found.pop(0)
        if isinstance(result, str):
            raise RigFault(result)
        return result

    def findings(self) -> tuple[Finding, ...]:
        self.documents_read += 1
        return (Finding("its file has another revision", is_error=False),)

    def close(self) -> None:
        self.closed += 1


@pytest.mark.parametrize(
    ("found", "watchdog", "fault"),
    [
        ([None], None, ""),
        ([IN_TIME], IN_TIME, ""),
        ([TOO_SLOW, IN_TIME], IN_TIME, ""),
        ([TOO_SLOW, WatchdogTimes(0.05, {"drive_1": 0.09}), TOO_SLOW], TOO_SLOW, ""),
        ([TOO_SLOW, "no frame comes back"], None, "no frame comes back"),
    ],
)
def test_the_shortest_measurement_of_a_watchdog_counts(found: Any, watchdog: WatchdogTimes | None, fault: str) -> None:
    """Each is an upper bound, since the measuring program may be late."""
    rig, count = WatchedRig(list(found)), len(found)
    check = with_watchdog(GOOD, lambda: rig)
    assert (check.watchdog, check.watchdog_fault) == (watchdog, fault)
    assert (rig.found, rig.closed, rig.documents_read) == ([], count, 1)
    assert check.remarks == (() if fault else ("its file has another revision",))
    assert with_watchdog(replace(GOOD, fault="a drive failed"), lambda: rig).fault == "a drive failed"


def test_contradictions_of_documents_are_failures_and_doubts_are_remarks() -> None:
    check = with_findings(
        replace(GOOD, simulated=True), [Finding("the PDO is fixed"), Finding("perhaps", is_error=False)]
    )
    assert check.failures() == ["the PDO is fixed"]
    assert check.remarks == ("perhaps",)
    assert "not passed: the PDO is fixed" in describe(check, bus=True)


@pytest.mark.parametrize(
    ("age", "valid"),
    [(0, True), (6.99, True), (7.01, False), (-1, False)],
)
def test_a_check_expires_after_a_week(tmp_path: Path, age: float, valid: bool) -> None:
    rig_file = tmp_path / "rig.toml"
    rig_file.write_text("")
    file = write_check(rig_file, fingerprint(rig_file), GOOD)
    written = datetime.now(UTC) - timedelta(days=age)
    file.write_text(json.dumps({**json.loads(file.read_text()), "date": written.isoformat()}))
    with nullcontext() if valid else pytest.raises(InputError, match="older than 7 days; run `stepgap rig check"):
        checked(rig_file)


def test_a_check_is_valid_for_these_settings_on_this_machine_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig_file = tmp_path / "my.rig.toml"
    with pytest.raises(InputError, match="No such file"):
        checked(rig_file)
    rig_file.write_text("tick = 0.001\n")
    with pytest.raises(InputError, match=f"there is no result of a check; run `stepgap rig check {rig_file}` first"):
        checked(rig_file)
    file = write_check(rig_file, fingerprint(rig_file), GOOD)
    assert file == proof_file(rig_file, "check") == tmp_path / "my.rig.check.json"
    checked(rig_file)
    content = json.loads(file.read_text("utf-8"))
    assert content["timing"]["p99"] == 2e-6
    assert (content["passed"], content["host"], content["kernel"]) == (True, platform.node(), platform.release())
    for module, name, message in (
        (platform, "node", "another machine"),
        (platform, "release", "another kernel"),
        (os, "getuid", "by another user"),
    ):
        with monkeypatch.context() as patched:
            patched.setattr(module, name, lambda: "elsewhere")
            with pytest.raises(InputError, match=message):
                checked(rig_file)
    write_check(rig_file, fingerprint(rig_file), replace(GOOD, timing=replace(GOOD.timing, ticks=4999)))
    with pytest.raises(InputError, match=r"measured 4\.999 s, less than 5"):
        checked(rig_file)
    rig_file.write_text("tick = 0.002\n")
    with pytest.raises(InputError, match="have changed since"):
        checked(rig_file)


@pytest.mark.parametrize("content", ["", "[]", "nonsense", "{}", '{"passed": true}', "[" * 100_000])
def test_an_invalid_result_is_refused(tmp_path: Path, content: str) -> None:
    rig_file = tmp_path / "rig.toml"
    rig_file.write_text("")
    proof_file(rig_file, "check").write_text(content)
    with pytest.raises(InputError, match=r"first$"):
        checked(rig_file)


def test_a_check_that_was_not_passed_is_refused(tmp_path: Path) -> None:
    rig_file = tmp_path / "rig.toml"
    rig_file.write_text("")
    write_check(rig_file, fingerprint(rig_file), replace(GOOD, fault="a drive failed"))
    with pytest.raises(InputError, match="not passed"):
        checked(rig_file)


def test_a_clock_out_of_its_limits_fails_the_check(tmp_path: Path) -> None:
    limits = ClockLimits(1.25e-4, 2.5e-4, 20, 1e-6)
    clock = ClockCheck(limits, ticks=5000, p99_9=1e-4, worst=2e-4, differences={"slave 1": 2e-8})
    good, bad = replace(GOOD, clock=clock), replace(GOOD, clock=replace(clock, p99_9=2e-4))
    assert not good.failures()
    assert "frames within 125 µs (99.9 %), clocks within 1 µs" in describe(good, bus=True)
    assert "no distributed clocks" in describe(GOOD, bus=True)
    assert "must be within 125.0 µs (dc.usual)" in describe(bad, bus=True)
    rig_file = tmp_path / "rig.toml"
    rig_file.write_text("")
    for check, passed in ((good, True), (bad, False)):
        content = json.loads(write_check(rig_file, fingerprint(rig_file), check).read_text("utf-8"))
        assert (content["passed"], content["clock"]["limits"]["usual"]) == (passed, 1.25e-4)
