"""`stepgap cure`: from a log to a corrector, or to the reason why not."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from stepgap.base.errors import InputError
from stepgap.cure.cli.cure import cure
from stepgap.cure.cure_page import verdict
from stepgap.cure.drive import HandDrive, check_distance, read_drive
from stepgap.cure.habits import Habit, commands_to_drive, habits_of, stands_at_zero
from stepgap.cure.lesson import Lesson, lesson_of
from stepgap.cure.response import Response, response_of, with_strays
from stepgap.experiment.settings import read_experiment
from stepgap.records.steps_csv import read_step_log
from stepgap.step import Array
from tests.cure.drives import DRIFT, GAINS, LAG, SWAY, drive, turned, written
from tests.logs.cli.test_cli_walks import write_bag
from tests.logs.sections.walking_logs import walking


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(tmp_path_factory.mktemp("log"), *drive())


@pytest.mark.parametrize("stamped", [False, True])
def test_commands_and_odometry_of_a_bag_are_found_by_their_types(stamped: bool, tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", walking(40.0, 1), stamped=stamped)
    found = read_drive(str(tmp_path / "bag"))
    assert (found.command.name, found.command.kind) == ("/cmd_vel", f"geometry_msgs/Twist{'Stamped' * stamped}")
    response = response_of(found)
    np.testing.assert_allclose(np.diag(response.gains), 0.8, atol=0.05)
    assert not found.notes


def test_a_bag_of_motion_capture_gives_the_same_velocities_as_odometry(tmp_path: Path) -> None:
    found = list[HandDrive]()
    for by_pose in (False, True):
        write_bag(tmp_path / f"bag{by_pose}", walking(40.0, 1), stamped=False, by_pose=by_pose)
        found.append(read_drive(str(tmp_path / f"bag{by_pose}")))
    odometry, poses = found
    assert (odometry.measured.kind, poses.measured.kind) == ("nav_msgs/Odometry", "geometry_msgs/PoseStamped")
    np.testing.assert_allclose(response_of(poses).gains, response_of(odometry).gains, atol=0.01)
    assert poses.notes == ("Velocities are the displacements of /odom, as the robot sees them.",)


def test_topics_may_have_the_name_of_a_field(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", walking(20.0, 1), stamped=False, by_pose=True, topics=("/mocap/pose", "/robot/twist"))
    found = read_drive(str(tmp_path / "bag"), odometry="/mocap/pose")
    assert (found.measured.name, found.measured.kind) == ("/mocap/pose", "geometry_msgs/PoseStamped")
    assert (found.command.name, found.command.kind) == ("/robot/twist", "geometry_msgs/Twist")


@pytest.fixture(scope="module")
def lesson(log: str) -> Lesson:
    found = read_drive(log)
    return lesson_of([found], response_of(found))


def test_delay_lag_gains_and_period_are_those_of_the_robot(lesson: Lesson) -> None:
    response = lesson.response
    assert response.delay + response.lag == pytest.approx(0.06 + LAG, abs=0.03)
    np.testing.assert_allclose(np.diag(response.gains), GAINS, atol=0.03)
    np.testing.assert_allclose(response.drift, DRIFT, atol=0.02)
    assert response.period == pytest.approx(SWAY, rel=0.04)
    assert response.step == pytest.approx(SWAY, rel=0.04), "a step is whole periods"


def test_what_it_does_is_said_in_sentences_and_the_corrected_command_makes_it_do_what_is_asked(lesson: Lesson) -> None:
    standing, forward, *_ = habits_of(lesson)
    np.testing.assert_allclose(standing.does, DRIFT, atol=0.025)
    assert standing.in_words().startswith("Asked to stand, it ")
    assert "drifts 0.0" in standing.in_words()
    assert "(6°/s) to the right" in standing.in_words()
    assert forward.in_words().startswith("Asked for 0.50 m/s straight on, it walks 0.4")
    np.testing.assert_allclose(GAINS * forward.corrected + DRIFT, forward.asked, atol=0.03)
    assert not stands_at_zero(lesson)


def test_a_sentence_names_what_is_sure_alone() -> None:
    quiet = Habit(np.array([0.4, 0, 0]), np.array([0.31, 0.01, 0.12]), np.full(3, 0.01), True, np.zeros(3))
    assert quiet.in_words() == (
        "Asked for 0.40 m/s straight on, it walks 0.31 m/s forward and turns 0.12 rad/s (7°/s) to the left."
    )
    unsure = replace(quiet, std=np.full(3, 0.2))
    assert unsure.in_words() == "Asked for 0.40 m/s straight on, it has no velocity that is sure."
    assert replace(unsure, does=np.zeros(3)).in_words() == unsure.in_words()
    still = replace(unsure, does=np.zeros(3), std=np.full(3, 0.02))
    assert still.in_words() == "Asked for 0.40 m/s straight on, it stands."
    aside = Habit(np.array([0, 0.2, 0]), np.array([-0.1, 0.15, 0]), np.full(3, 0.01), True, np.zeros(3))
    assert aside.in_words() == "Asked for 0.20 m/s to the left, it walks 0.10 m/s backward and 0.15 m/s to the left."


def test_where_nothing_is_left_to_correct_the_interval_is_zero(lesson: Lesson) -> None:
    cured = replace(lesson, held=replace(lesson.held, asked=0.5 * lesson.held.predicted))
    assert "it would remove 0 % (95 % interval 0 to 0 %)" in verdict(cured)


def test_most_of_the_error_can_be_corrected_and_that_is_sure(lesson: Lesson) -> None:
    share, half = lesson.held.correctable(lesson.space.state_scale, lesson.driven)
    assert 0.6 < share < 1
    assert half < 0.2


def test_ten_commands_are_proposed_within_those_that_were_driven(lesson: Lesson) -> None:
    commands = commands_to_drive(lesson)
    assert commands.shape == (10, 3)
    assert len(np.unique(commands, axis=0)) == 10
    assert (commands >= lesson.space.command_lower).all()
    assert (commands <= lesson.space.command_upper).all()


def test_the_folder_has_page_passport_and_correctors(
    log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cure(log, out=tmp_path / "cure", name="unit 7")
    names = {file.name for file in (tmp_path / "cure").iterdir()}
    assert names == {
        "index.html", "passport.json", "model.json", "controller.py", "controller.c", "controller.h",
        "velocity_filter.py", "cmd_vel_correction.py", "correction.launch.py", "experiment.toml", "steps.csv",
        "next_commands.csv",
    }  # fmt: skip
    passport = json.loads((tmp_path / "cure/passport.json").read_text())
    assert passport["name"] == "unit 7"
    assert all(error["after"] < error["before"] for error in passport["errors"])
    settings = read_experiment(tmp_path / "cure/experiment.toml")
    steps = read_step_log(tmp_path / "cure/steps.csv", settings.robot.space)
    assert len(steps) == passport["steps"], "a run can begin with them"
    said = capsys.readouterr().out
    assert "Asked to stand, it " in said
    assert "% can be corrected" in said
    for program in ("cmd_vel_correction.py", "correction.launch.py", "velocity_filter.py"):
        text = (tmp_path / "cure" / program).read_text()
        compile(text, program, "exec")
        assert "@DEFAULTS@" not in text
        assert "@STAMPED@" not in text
    with pytest.raises(InputError, match="exists already"):
        cure(log, out=tmp_path / "cure")


def shifted(odometry: Array, seconds: float) -> Array:
    return np.column_stack([odometry[:, 0] + seconds, odometry[:, 1:]])


def changed(folder: Path, change: Callable[[Array, Array], tuple[Array, Array]], delay: float = 0.06) -> str:
    return written(folder, *change(*drive(delay=delay)))


def response_to(text: str) -> Response:
    return response_of(read_drive(text))


@pytest.mark.parametrize("late", [0.05, 0.2])
def test_odometry_that_is_late_is_found_as_a_delay(late: float, tmp_path: Path) -> None:
    text = changed(tmp_path, lambda odometry, commands: (shifted(odometry, late), commands))
    response = response_to(text)
    assert response.delay + response.lag == pytest.approx(0.06 + LAG + late, abs=0.04)


def test_odometry_before_its_commands_is_refused(tmp_path: Path) -> None:
    text = changed(tmp_path, lambda odometry, commands: (shifted(odometry, -0.4), commands))
    with pytest.raises(InputError, match=r"comes 0\.\d+ s before the commands that it follows, so their clocks differ"):
        response_to(text)


def test_a_robot_of_which_a_part_follows_slowly_is_not_taken_for_one_with_another_clock(tmp_path: Path) -> None:
    """A long lag and a delay below zero explain its motion a little better than those that it has."""

    def half_slow(odometry: Array, commands: Array) -> tuple[Array, Array]:
        share = 0.02 / 1.5  # of the difference, in each row, with a time constant of 1.5 s
        slow = lfilter([share], [1, share - 1], odometry[:, 1:4], axis=0)
        return np.column_stack([odometry[:, :1], (odometry[:, 1:4] + slow) / 2, odometry[:, 4:]]), commands

    assert response_of(read_drive(changed(tmp_path, half_slow))).delay >= 0


def test_velocities_in_the_frame_of_the_world_are_turned(tmp_path: Path) -> None:
    def in_world(odometry: Array, commands: Array) -> tuple[Array, Array]:
        seen = np.array([turned(row[1:3], row[6]) for row in odometry])
        return np.column_stack([odometry[:, :1], seen, odometry[:, 3:]]), commands

    found = read_drive(changed(tmp_path, in_world))
    assert found.is_turned
    assert any("frame of the world" in note for note in found.notes)
    np.testing.assert_allclose(np.diag(response_of(found).gains), GAINS, atol=0.05)


def test_gaps_and_frozen_numbers_are_left_out(tmp_path: Path) -> None:
    def with_gaps(odometry: Array, commands: Array) -> tuple[Array, Array]:
        kept = (odometry[:, 0] % 20 > 2) | (odometry[:, 0] < 5)
        frozen = (odometry[:, 0] > 50) & (odometry[:, 0] < 60)
        odometry[frozen, 1:4] = odometry[np.argmax(frozen), 1:4]
        return odometry[kept], commands

    found = read_drive(changed(tmp_path, with_gaps))
    assert any("repeats the same numbers" in note for note in found.notes)
    learned = lesson_of([found], response_of(found))
    np.testing.assert_allclose(np.diag(learned.response.gains), GAINS, atol=0.05)
    assert (np.abs(learned.steps.next_state - learned.steps.command) < 0.6).all()


def test_places_that_a_motion_capture_repeats_while_it_sees_no_robot_are_left_out(tmp_path: Path) -> None:
    odometry, commands = drive()
    lost = (odometry[:, 0] % 25 > 20) & (odometry[:, 0] > 25)
    odometry[lost, 4:] = odometry[np.maximum.accumulate(np.where(lost, 0, np.arange(len(lost)))), 4:][lost]
    text = written(tmp_path, odometry[:, [0, 4, 5, 6, 4, 5, 6]], commands)
    table = tmp_path / "odom.csv"
    table.write_text(table.read_text().replace("time,vx,vy,wz,", "time,a,b,c,"))
    found = read_drive(text)
    assert any("repeats the same numbers" in note for note in found.notes)
    np.testing.assert_allclose(np.diag(response_of(found).gains), GAINS, atol=0.05)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda odometry, commands: (odometry, commands * [1, 1, 1, -1]), "wz goes the other way than its command"),
        (lambda odometry, commands: (odometry, commands[:, [0, 3, 2, 1]]), "the command of vx moves wz .* and not vx"),
        (lambda odometry, commands: (odometry, commands * [1, 0, 0, 0]), "its command never changes"),
        (
            lambda odometry, commands: (odometry, commands * [1, 1, 1, 57.3]),
            "command of wz is up to .* degrees per sec",
        ),
        (
            lambda odometry, commands: (odometry * [1, 1, 1, 57.3, 1, 1, 1], commands),
            "velocity of wz is .* degrees per",
        ),
        (
            lambda odometry, commands: (odometry, commands * [1, 1000, 1000, 1]),
            "command of vx is up to .* is this in mm/s",
        ),
        (
            lambda odometry, commands: (odometry * [1, 10, 10, 1, 1, 1, 1], commands),
            "vx is 8.* times its command; .* m/s",
        ),
        (
            lambda odometry, commands: (shifted(odometry, 1.5), commands),
            "follow its commands after 1 s or more, .* clocks differ",
        ),
        (
            lambda odometry, commands: (shifted(odometry, 0.6), commands),
            r"after 0\.[67]\d? s or more, which is longer than a",
        ),
        (lambda odometry, commands: (odometry[::10], commands), "odometry .* every 0.2 s, and a step of .* needs 4"),
        (lambda odometry, commands: (odometry[:700], commands[:140]), "steps of .* s can be used, 40 are needed"),
    ],
    ids=[
        "sign",
        "mixed",
        "constant",
        "degrees",
        "odometry in degrees",
        "millimetres",
        "times 10",
        "late",
        "later than a step",
        "rare",
        "short",
    ],
)
def test_a_log_that_says_nothing_is_refused_with_the_reason(
    change: Callable[[Array, Array], tuple[Array, Array]], reason: str, tmp_path: Path
) -> None:
    found = read_drive(changed(tmp_path, change))
    with pytest.raises(InputError, match=reason):
        lesson_of([found], response_of(found))


def test_parts_in_which_the_robot_was_carried_or_lay_are_named(log: str, tmp_path: Path) -> None:
    def lying(odometry: Array, commands: Array) -> tuple[Array, Array]:
        lies = (odometry[:, 0] > 40) & (odometry[:, 0] < 60)
        odometry[lies, 1:4] = np.random.default_rng(0).normal(0, 0.02, (np.count_nonzero(lies), 3))
        return odometry, commands

    notes = list[tuple[str, ...]]()
    for text in (log, changed(tmp_path, lying)):
        found = read_drive(text)
        notes.append(with_strays(found, response_of(found)).notes)
    assert notes[0] == ()
    assert notes[1][0].startswith("From 40 to 50, 45 to 55, 50 to 60 s after its begin the motion does not follow")


def test_every_log_is_checked_and_not_only_the_longest(log: str, tmp_path: Path) -> None:
    def mirrored(odometry: Array, commands: Array) -> tuple[Array, Array]:
        return odometry[:2000] * [1, 1, -1, 1, 1, 1, 1], commands[:400]

    with pytest.raises(InputError, match="vy goes the other way than its command"):
        cure(log, changed(tmp_path, mirrored), out=tmp_path / "cure")


def test_a_velocity_that_was_never_commanded_is_not_corrected_but_proposed(tmp_path: Path) -> None:
    found = read_drive(changed(tmp_path, lambda odometry, commands: (odometry, commands * [1, 1, 0, 1])))
    learned = lesson_of([found], response_of(found))
    assert learned.driven.tolist() == [True, False, True]
    assert commands_to_drive(learned)[:2].tolist() == [[0, 0.15, 0], [0, -0.15, 0]]
    assert all(habit.corrected[1] == habit.asked[1] for habit in habits_of(learned))


def test_a_measured_distance_says_whether_odometry_is_plausible(log: str) -> None:
    found = read_drive(log)
    _, apart = found.way()
    assert "plausible" in check_distance(found, apart)
    with pytest.raises(InputError, match=r"what would be corrected is the odometry, not the robot"):
        check_distance(found, 2 * apart)


def test_of_several_topics_one_has_to_be_chosen(tmp_path: Path) -> None:
    odometry, commands = drive(20)
    text = written(tmp_path, odometry, commands)
    names = "time,/nav.linear.x,/nav.linear.y,/nav.angular.z,/joy.linear.x,/joy.linear.y,/joy.angular.z"
    both = np.hstack([commands, commands[:, 1:]])
    np.savetxt(tmp_path / "both.csv", both, delimiter=",", header=names, comments="")
    text = f"{tmp_path / 'odom.csv'}+{tmp_path / 'both.csv'}"
    with pytest.raises(InputError, match="2 topics may be the velocity command: /nav, /joy; choose one by --command"):
        read_drive(text)
    assert read_drive(text, command="/joy").command.name == "/joy"
    with pytest.raises(InputError, match="no such velocity command; there is /nav, /joy"):
        read_drive(text, command="/teleop")
    with pytest.raises(InputError, match="no velocity commands"):
        read_drive(str(tmp_path / "odom.csv"))
    with pytest.raises(InputError, match="no odometry"):
        read_drive(str(tmp_path / "cmd.csv"))
