"""Steps of equal length between changes of a command, with the mean velocity of each."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stepgap.logs.sections.held_commands import held_commands, held_in_steps, regular_sections
from stepgap.logs.sections.section_settings import SectionSettings
from stepgap.logs.sections.signals import Signal
from stepgap.logs.sections.step_extraction import ExtractedSteps, extract_steps
from stepgap.records.steps_csv import RecordError
from tests.logs.sections.walking_logs import DELAY, LAG, walking, write_walk

TWIST = SectionSettings(
    every=0.5, state=("mean(vx)", "mean(vy)", "mean(wz)"), command=("cx", "cy", "cw")
)  # fmt: skip
POSE = replace(
    TWIST, pose=("x", "y", "yaw"), state=("vx=mean(rate(forward))", "vy=mean(rate(left))", "wz=mean(rate(turn))")
)


def extracted(folder: Path, settings: SectionSettings) -> ExtractedSteps:
    return extract_steps(f"{folder / 'odom.csv'}+{folder / 'cmd.csv'}", None, settings)


def steps_of(
    times: list[float], values: list[float], last: float, hold: float = 99.0
) -> list[tuple[float, float, str]]:
    """Begin, command and doubt of each step of 0.5 s."""
    commands = held_commands([Signal(np.array(times), np.array(values))], hold)
    sections = regular_sections(commands, 0.5, -9.0, last)
    found = held_in_steps(commands, sections, 0.5)
    begins = [section.time for section in sections[:-1]]
    return [
        (round(begin, 9), value, doubt)
        for begin, value, doubt in zip(begins, found.values[:, 0].tolist(), found.doubts, strict=True)
    ]


def test_steps_begin_where_the_command_changes() -> None:
    changes = "the command changes within 0.5 s"
    assert steps_of([0, 1.2, 2.2], [1, 2, 1], 3.3) == [
        (0.0, 1, "no command is known before it"),
        (0.5, 1, ""),
        (1.0, 1, changes),
        (1.2, 2, ""),
        (1.7, 2, ""),
        (2.2, 1, ""),
        (2.7, 1, ""),
    ]


def test_a_step_is_stretched_to_a_change_and_one_after_a_short_command_is_left_out() -> None:
    short = "another change of the command less than 0.5 s before it"
    found = steps_of([0, 0.53, 1.0, 1.3], [1, 2, 3, 4], 2.0)
    assert found == [
        (0.0, 1, "no command is known before it"),
        (0.53, 2, ""),  # of 0.47 s
        (1.0, 3, "the command changes within 0.5 s"),
        (1.3, 4, short),
    ]


def test_a_repeated_command_is_no_change_and_one_that_ceases_is_not_known() -> None:
    times = [0.1 * number for number in range(21)] + [5.0, 5.1, 5.2, 5.3, 5.4, 5.5, 5.6, 5.7]
    found = steps_of(times, [1.0] * len(times), 9.0, hold=0.0)
    assert [begin for begin, _, doubt in found if not doubt] == [0.5, 1.0, 1.5, 2.0, 5.5]


@pytest.mark.parametrize(("settings", "noise"), [(TWIST, 0.02), (POSE, 0.002)], ids=["twist", "pose"])
def test_states_are_the_true_means_and_commands_those_that_held(
    settings: SectionSettings, noise: float, tmp_path: Path
) -> None:
    log = walking(120.0, 3)
    write_walk(log, tmp_path, noise)
    found = extracted(tmp_path, settings)
    assert not found.refusal
    assert len(found.kept) > 120
    time, state, std = found.sections.time, found.sections.state, found.sections.std
    ratios: list[float] = []
    for number in found.kept:
        inside = (log.sent >= time[number] - 1e-6) & (log.sent < time[number + 1] - 1e-6)
        assert (log.command[inside] == found.values["command"][number]).all()
        assert abs(time[number + 1] - time[number] - 0.5) <= 0.0501
        true = log.mean(time[number], time[number + 1])
        ratios += ((state[number + 1] - true) / std[number + 1]).tolist()
        assert np.abs(state[number + 1] - true).max() < 0.03
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 1.6


def test_the_same_motion_in_another_frame_gives_the_same_states(tmp_path: Path) -> None:
    """The world's frame is arbitrary, and a quaternion says the same as a yaw, also with its sign changed."""
    log = walking(40.0, 4)
    write_walk(log, tmp_path)
    one = extracted(tmp_path, POSE)
    angle = 2.0
    x, y, yaw = log.pose.T
    turned = np.stack([np.cos(angle) * x - np.sin(angle) * y + 5, np.sin(angle) * x + np.cos(angle) * y, yaw + angle])
    quaternion = np.stack([0 * yaw, 0 * yaw, np.sin(turned[2] / 2), np.cos(turned[2] / 2)])
    quaternion[:, ::3] *= -1
    names = [f"p.position.{axis}" for axis in "xy"] + [f"p.orientation.{axis}" for axis in "xyzw"]
    rows = np.column_stack([log.time, *turned[:2], *quaternion])[::4]
    np.savetxt(tmp_path / "odom.csv", rows, delimiter=",", header=",".join(["time", *names]), comments="")
    other = extracted(tmp_path, replace(POSE, pose=("p",)))
    assert one.kept == other.kept
    np.testing.assert_allclose(one.sections.state[1:], other.sections.state[1:], atol=1e-6)


def test_jumps_lost_odometry_and_glitches_leave_their_steps_out(tmp_path: Path) -> None:
    log = walking(60.0, 5)
    pose, velocity = log.pose.copy(), log.velocity.copy()
    pose[log.time > 20.1] += [3.0, 0.0, 0.0]
    velocity[np.abs(log.time - 30.1) < 0.003] = 50.0
    kept = np.abs(log.time - 40.1) > 0.2
    for settings, moments in ((TWIST, (30.1, 40.1)), (POSE, (20.1, 40.1))):
        worse = replace(log, time=log.time[kept], pose=pose[kept], velocity=velocity[kept])
        write_walk(worse, tmp_path, every=1)
        found = extracted(tmp_path, settings)
        steps = [(found.sections.time[number], found.sections.time[number + 1]) for number in found.kept]
        for moment in moments:
            assert not any(begin - 0.4 < moment < end for begin, end in steps)
        assert all(
            np.abs(found.sections.state[number + 1] - log.mean(*found.sections.time[[number, number + 1]])).max() < 0.02
            for number in found.kept
        )
        assert len(found.kept) > 50


def test_a_log_without_commands_is_divided_evenly(tmp_path: Path) -> None:
    write_walk(walking(10.0, 0), tmp_path)
    found = extract_steps(str(tmp_path / "odom.csv"), None, replace(TWIST, command=()))
    np.testing.assert_allclose(np.diff(found.sections.time[:-1]), 0.5)
    assert len(found.kept) == 19


def test_a_command_that_never_holds_is_refused(tmp_path: Path) -> None:
    log = walking(10.0, 0)
    write_walk(replace(log, command=log.command + log.sent[:, None]), tmp_path)
    with pytest.raises(RecordError, match=r"cmd\.csv: no command holds for 0\.5 s from 0\.000 to 9\.980 s"):
        extracted(tmp_path, replace(TWIST, hold=0.3))


def test_means_over_a_gait_cycle(tmp_path: Path) -> None:
    """A cycle of a phase from 0 to 1, with a velocity that varies in it: the state is the mean of a whole cycle."""
    time = np.arange(0, 20, 0.01)
    phase = (time / 0.6) % 1
    velocity = 0.3 + 0.01 * time + 0.1 * np.sin(2 * np.pi * phase)
    rows = np.column_stack([time, phase, velocity])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="time,phase,vx", comments="")
    settings = SectionSettings(crossing="phase", level=0.5, state=("mean(vx)",))
    found = extract_steps(str(tmp_path / "log.csv"), None, settings).sections
    np.testing.assert_allclose(np.diff(found.time), 0.6, atol=0.011)
    np.testing.assert_allclose(found.state[1:, 0], 0.3 + 0.01 * (found.time[1:] - 0.3), atol=0.002)


@pytest.mark.parametrize("settings", [TWIST, POSE], ids=["twist", "pose"])
def test_a_log_whose_clocks_differ_is_refused_unless_they_are_corrected(
    settings: SectionSettings, tmp_path: Path
) -> None:
    log = walking(90.0, 6)
    write_walk(log, tmp_path, 0.003)
    right = extracted(tmp_path, settings)
    assert right.lag == pytest.approx(DELAY + LAG * np.log(2), abs=0.06)  # a lag is most like this delay
    write_walk(replace(log, sent=log.sent + 0.4), tmp_path, 0.003)
    refusal = extracted(tmp_path, settings).refusal
    assert re.search(r"the motion comes 0\.25? s before the command that it follows, so their clocks differ", refusal)
    corrected = extracted(tmp_path, replace(settings, delay=-0.4))
    assert (corrected.refusal, corrected.faults) == ("", right.faults)
    np.testing.assert_allclose(corrected.sections.state[1:], right.sections.state[1:], atol=1e-3)


def test_a_robot_that_does_not_follow_its_commands_has_no_lag(tmp_path: Path) -> None:
    log = walking(60.0, 7)
    write_walk(replace(log, command=log.command[np.random.default_rng(0).permutation(len(log.command))]), tmp_path)
    assert np.isnan(extracted(tmp_path, replace(TWIST, every=0.1)).lag)


def test_commands_may_be_in_a_file_of_plans(tmp_path: Path) -> None:
    write_walk(walking(20.0, 8), tmp_path)
    joined = extracted(tmp_path, TWIST)
    planned = extract_steps(str(tmp_path / "odom.csv"), tmp_path / "cmd.csv", TWIST)
    assert planned.faults == joined.faults
    np.testing.assert_array_equal(planned.values["command"], joined.values["command"])
