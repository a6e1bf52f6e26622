"""Steps of logs whose truth is known: right where they are given, left out where they are doubtful, never wrong."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from stepgap.logs.sections.section_finding import FoundSection
from stepgap.logs.sections.section_settings import SectionSettings
from stepgap.logs.sections.signals import SignalLog
from stepgap.logs.sections.step_extraction import ExtractedSteps, extract_steps
from stepgap.records.steps_csv import RecordError
from tests.logs.sections.hopping_logs import (
    GRAVITY,
    TOUCHDOWN,
    Change,
    HoppingLog,
    glitches,
    hopping,
    lost_rows,
    lost_values,
    noisy,
    repeated,
    rounded,
    slower,
    slower_forward,
    write,
)
from tests.logs.sections.scored_steps import Score, trial

STATE = ("speed=rate(forward)", "height")
APEXES = SectionSettings(height="height", state=STATE, command=("number",))
BOOM = 1.8


def logged(folder: Path, *changes: Change, hops: int = 25, seed: int = 0) -> HoppingLog:
    """Writes log.csv and plan.csv."""
    rng = np.random.default_rng(seed)
    log = hopping(hops, rng)
    for change in changes:
        log = change(log, rng)
    write(log, folder, rng)
    return log


def extracted(folder: Path, settings: SectionSettings, plan: bool = True) -> ExtractedSteps:
    return extract_steps(str(folder / "log.csv"), folder / "plan.csv" if plan else None, settings)


NOISE, ROUNDING = (noisy(0.003),), (rounded(0.005),)
ALL = (noisy(0.0005), rounded(0.001), lost_rows(4, 0.15), repeated(5, 0.08), glitches(20, 0.02))


@pytest.mark.parametrize(
    ("rule", "changes"),
    [
        pytest.param("height", NOISE, id="noise"),
        pytest.param("force", NOISE, id="noise, force"),
        pytest.param("height", ROUNDING, id="rounding"),
        pytest.param("phase", ROUNDING, id="rounding, phase"),
        pytest.param("height", (slower(5), noisy(0.0005)), id="half slower"),
        pytest.param("phase", (slower_forward(10), lost_values(0.01)), id="slow position, zeros"),
        pytest.param("phase", (glitches(40, 0.02), noisy(0.0005)), id="glitches"),
        pytest.param("height", ALL, id="all"),
        pytest.param("phase", ALL, id="all, phase"),
        pytest.param("force", ALL, id="all, force"),
    ],
)
def test_no_row_is_wrong(rule: str, changes: tuple[Change, ...], tmp_path: Path) -> None:
    found = trial(changes, rule, 30, 11, tmp_path)
    assert isinstance(found, Score)
    assert (found.wrong, found.refused) == (0, False)
    assert found.steps >= 21
    assert (np.sqrt(np.mean(found.standardised**2, axis=0)) < 2).all()


def test_a_lost_plan_affects_its_step_alone(tmp_path: Path) -> None:
    logged(tmp_path)
    lines = (tmp_path / "plan.csv").read_text().splitlines()
    (tmp_path / "plan.csv").write_text("\n".join(lines[:8] + lines[9:]))
    found = extracted(tmp_path, APEXES)
    assert found.faults == tuple("no plan" if number == 7 else "" for number in range(24))
    assert [found.values["command"][number, 0] for number in found.kept] == found.kept


def test_rows_that_are_lost_leave_their_steps_out(tmp_path: Path) -> None:
    apex = hopping(25, np.random.default_rng(0)).apexes[9, 0]

    def gap(log: HoppingLog, _: np.random.Generator) -> HoppingLog:
        keep = np.abs(log.time - apex) > 0.2
        rows = {name: getattr(log, name)[keep] for name in ("time", "height", "forward", "flight", "force")}
        return replace(log, **rows)

    log = logged(tmp_path, gap)
    found = extracted(tmp_path, APEXES)
    begins = [int(np.abs(log.apexes[:, 0] - found.sections.time[number]).argmin()) for number in found.kept]
    assert begins == [number for number in range(24) if number not in (8, 9)]
    np.testing.assert_allclose(found.sections.state[found.kept], log.apexes[begins, 1:], atol=1e-5)


@pytest.mark.parametrize("at", ["begin", "end"])
def test_lift_off_and_touch_down(at: Literal["begin", "end"], tmp_path: Path) -> None:
    log = logged(tmp_path, noisy(0.0002))
    settings = SectionSettings(phase="phase", at=at, state=("rise=rate(height)", "height", "speed=rate(forward)"))
    found = extracted(tmp_path, settings, plan=False)
    launch = np.sqrt(2 * GRAVITY * (log.apexes[:, 2] - TOUCHDOWN))
    expected = np.stack([launch * (1 if at == "begin" else -1), np.full(25, TOUCHDOWN), log.apexes[:, 1]], axis=-1)
    assert len(found.kept) == 24
    ratios = (found.sections.state - expected) / found.sections.std
    assert np.sqrt(np.mean(ratios**2, axis=0)).max() < 2.5
    np.testing.assert_allclose(found.sections.state, expected, atol=0.06)


def test_a_crossing(tmp_path: Path) -> None:
    """Just above lift-off, even the shortest window reaches into the stance of a fast hop, which is noticed."""
    log = logged(tmp_path)
    level = TOUCHDOWN + 0.02
    settings = SectionSettings(crossing="height", level=level, state=("rise=rate(height)",))
    rise = np.sqrt(2 * GRAVITY * (log.apexes[:, 2] - level))
    found = extracted(tmp_path, settings, plan=False).sections
    np.testing.assert_allclose(found.time, log.apexes[:, 0] - rise / GRAVITY, atol=1e-3)
    sure = np.array([not doubt for doubt in found.doubts])
    assert 15 < sure.sum() < 25
    np.testing.assert_allclose(found.state[sure, 0], rise[sure], atol=0.003)
    assert np.abs(found.state[~sure, 0] - rise[~sure]).max() > 0.01
    short = extracted(tmp_path, replace(settings, window=0.01), plan=False).sections
    assert not any(short.doubts)
    np.testing.assert_allclose(short.state[:, 0], rise, atol=0.001)


def test_a_boom_gives_height_and_forward(tmp_path: Path) -> None:
    log = logged(tmp_path)
    angles = np.stack([log.time, np.arcsin(log.height / BOOM), log.forward / BOOM], axis=-1)
    np.savetxt(tmp_path / "log.csv", angles, delimiter=",", header="time,pitch,yaw", comments="")
    settings = SectionSettings(boom=BOOM, pitch="pitch", yaw="yaw", state=STATE, command=("number",))
    found = extracted(tmp_path, settings)
    np.testing.assert_allclose(found.sections.state, log.apexes[:, 1:], atol=1e-5)
    assert found.yaw is not None
    np.testing.assert_allclose(found.yaw, np.interp(log.apexes[:-1, 0], log.time, log.forward / BOOM), atol=1e-6)


def test_a_function_finds_the_sections(tmp_path: Path) -> None:
    log = logged(tmp_path)
    settings = SectionSettings(crossing="height", height="height", state=STATE)

    def every_second(_: SignalLog) -> list[FoundSection]:
        return [FoundSection(time) for time in log.apexes[::2, 0].tolist()]

    found = extract_steps(str(tmp_path / "log.csv"), None, settings, every_second)
    assert len(found.kept) == 12
    np.testing.assert_allclose(found.sections.state, log.apexes[::2, 1:], atol=1e-5)
    with pytest.raises(RecordError, match=r"log\.csv: 0 sections; at least two are needed"):
        extract_steps(str(tmp_path / "log.csv"), None, settings, lambda _: [])


def test_a_log_with_many_doubtful_sections_is_refused(tmp_path: Path) -> None:
    """A height that is lost at every third apex."""

    def losses(log: HoppingLog, _: np.random.Generator) -> HoppingLog:
        lost = (np.abs(log.time[:, None] - log.apexes[::3, 0]) < 0.06).any(axis=1)
        return replace(log, height=np.where(lost, np.nan, log.height))

    logged(tmp_path, losses)
    found = extracted(tmp_path, replace(APEXES, phase="phase"))
    assert found.refusal.endswith("log.csv: 9 of 25 sections are doubtful, most often: " + found.sections.doubts[0])


def test_a_misspelt_factor_is_refused(tmp_path: Path) -> None:
    logged(tmp_path)
    with pytest.raises(RecordError, match=r"factors: no column 'heigt'; did you mean 'height'\?"):
        extracted(tmp_path, replace(APEXES, factors={"heigt": 1e-3}))
    with pytest.raises(
        RecordError, match=r"plan\.csv: no column 'push'; there is time, number; nor has .*log\.csv one"
    ):
        extracted(tmp_path, replace(APEXES, command=("push",)))
    with pytest.raises(RecordError, match=r"rate\(number\): only coordinates of the state may be rates"):
        extracted(tmp_path, replace(APEXES, command=("rate(number)",)))
