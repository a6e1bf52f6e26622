"""The result of a check, and the settings and machine for which it is valid."""

import json
import platform
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.base.errors import InputError
from stepgap.plants.commissioning.check import (
    Check,
    Timing,
    check_file,
    checked,
    describe,
    fingerprint,
    timing_of,
    write_check,
)

TICK = 1e-3
GOOD = Check(
    tick=TICK,
    late_ticks=2,
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
    assert file == check_file(rig_file) == tmp_path / "my.rig.check.json"
    checked(rig_file)
    content = json.loads(file.read_text("utf-8"))
    assert content["timing"]["p99"] == 2e-6
    assert (content["passed"], content["host"], content["kernel"]) == (True, platform.node(), platform.release())
    for name, message in (("node", "another machine"), ("release", "another kernel")):
        with monkeypatch.context() as patched:
            patched.setattr(platform, name, lambda: "elsewhere")
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
    check_file(rig_file).write_text(content)
    with pytest.raises(InputError, match=r"first$"):
        checked(rig_file)


def test_a_check_that_was_not_passed_is_refused(tmp_path: Path) -> None:
    rig_file = tmp_path / "rig.toml"
    rig_file.write_text("")
    write_check(rig_file, fingerprint(rig_file), replace(GOOD, fault="a drive failed"))
    with pytest.raises(InputError, match="not passed"):
        checked(rig_file)
