"""Replay of a deployment: the same ticks as recorded, with the true state, and the cases that are refused."""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stepgap.base.errors import InputError
from stepgap.cli.app import main
from stepgap.experiment.loop import deployment_generator
from stepgap.experiment.plants import simulation_of
from stepgap.experiment.replay import FOOTPRINT, ground_of, logged_ticks, replay, replayed_steps
from stepgap.experiment.run import Run
from stepgap.experiment.settings import read_experiment
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_log import TickLog
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.records.steps_csv import RecordError, StepWriter, read_step_log
from stepgap.robots.hopper.kinematics import TRUE_UNITS
from stepgap.robots.hopper.model.dynamics import masses_of
from stepgap.robots.hopper.model.leg import foot, four_bar
from stepgap.robots.hopper.parameters import CommandBounds, RobotParameters
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.tick.tick_row import TICK_UNITS
from stepgap.step import StepStatus
from tests.hardware.ethercat.ring_process import skipping_without_network
from tests.quick_runs import leave_out_repeats, leave_out_report
from tests.rig_ticks import LOG_UNITS, rig_rows

TARGETS = "speed,height\n0.1,0.56\n0.2,0.58\n0.2,0.58\n"


def run_of(folder: Path, *arguments: str) -> Path:
    (folder / "targets.csv").write_text(TARGETS)
    paths = ["--reference", str(folder / "targets.csv"), "--out", str(folder / "run")]
    main(["run", *paths, "--seed", "5", "--quiet", *(arguments or ["--iterations", "1"])])
    return folder / "run"


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Sequence[float]]]:
    """A run folder, and the original ticks of its last deployment."""
    ticks: list[Sequence[float]] = []
    start = RigPlant.start

    def watched_start(plant: RigPlant) -> np.ndarray:
        ticks.clear()
        plant._on_ticks = lambda rows, step: ticks.extend(rows)
        return start(plant)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RigPlant, "start", watched_start)
        leave_out_repeats(patch)
        leave_out_report(patch)
        return run_of(tmp_path_factory.mktemp("watched")), ticks


@pytest.fixture(scope="module")
def run_folder(watched: tuple[Path, list]) -> Path:
    return watched[0]


@pytest.fixture(scope="module")
def replayed(run_folder: Path) -> TickTable:
    return replay(Run(run_folder), 1)


@pytest.fixture
def copy(run_folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(run_folder, tmp_path / "copy"))


def test_every_tick_equals_the_original_one(replayed: TickTable, watched: tuple[Path, list]) -> None:
    np.testing.assert_array_equal(replayed.selected(TICK_UNITS).rows, watched[1])
    assert list(replayed.units) == [*TICK_UNITS, *TRUE_UNITS, "step"]


def test_a_thinned_or_hop_by_hop_replay_is_the_same(run_folder: Path, replayed: TickTable) -> None:
    progress: list[tuple[int, int]] = []
    np.testing.assert_array_equal(
        replay(Run(run_folder), 1, 7, lambda *of: progress.append(of)).rows, replayed.rows[::7]
    )
    assert progress == [(1, 4), (2, 4), (3, 4), (4, 4)]
    hops = list(replayed_steps(Run(run_folder), 1))
    assert [set(hop["step"]) for hop in hops] == [{0}, {1}, {2}, {3}]
    np.testing.assert_array_equal(np.concatenate([hop.rows for hop in hops]), replayed.rows)


def test_the_true_state_is_that_at_the_reading_of_the_sensors(replayed: TickTable) -> None:
    units = 2 * np.pi / 16384
    front, rear = (replayed["true_alpha_1"] + sign * replayed["true_alpha_2"] for sign in (1, -1))
    for motor, angle in (("motor_1", front), ("motor_2", rear)):
        offset = replayed[motor] * units - angle
        assert np.ptp(offset) < 1.001 * units, "a constant zero error, and rounding"
    assert np.abs(units * replayed["boom_vertical"] - replayed["boom_pitch"]).max() < 0.501 * units
    arc = RobotParameters().boom_length * replayed["boom_yaw"]
    assert np.abs(arc - replayed["hip_x"]).max() < 0.02, "except for the boom's deflection"


def test_hip_leg_and_foot_make_one_robot(replayed: TickTable) -> None:
    robot = RobotParameters()
    leg = masses_of(robot).leg
    for row in range(0, len(replayed), 97):
        alpha_1, alpha_2, height = (replayed[name][row] for name in ("true_alpha_1", "true_alpha_2", "hip_height"))
        below = height - replayed["foot_z"][row]
        toe = foot(leg, four_bar(leg, alpha_2), alpha_1)
        assert below == pytest.approx(-toe.y, abs=2e-3), "except for the boom's tilt"
        assert robot.foot_length < below < 0.5
    standing = replayed["contact_force"] > 20
    sunk = (replayed["ground_height"] - replayed["foot_z"])[standing]
    assert -1e-4 < sunk.min() < sunk.max() < 0.02, "the ground yields a little"


def test_apexes_agree_with_the_recorded_steps(run_folder: Path, replayed: TickTable) -> None:
    log = read_step_log(run_folder / "steps.csv", CommandBounds().space())
    for logged in log.of_iteration(1):
        heights = replayed["hip_height"][replayed["step"] == logged.step]
        assert heights.max() == pytest.approx(max(logged.record.state[1], logged.record.next_state[1]), abs=0.03)


def test_a_deployment_that_ended_without_an_apex(tmp_path: Path) -> None:
    (tmp_path / "experiment.toml").write_text("seed = 4\n[gap]\nground_friction = 0.05\n")  # ice
    settings, none = read_experiment(tmp_path / "experiment.toml"), np.zeros(2)
    plant = simulation_of(settings).plant(deployment_generator(settings.seed, 0))
    with StepWriter(tmp_path / "steps.csv", settings.robot.space) as writer, plant:
        plant.start()
        reason, step = StepStatus.OK, 0
        while reason == StepStatus.OK and step < 20:
            record, step = plant.take_step(np.array([30.0, -20.0])), step + 1
            writer.append(LoggedStep(0, step, none, none, none, record))
            reason = record.status
    assert reason != StepStatus.OK
    assert np.isfinite(replay(Run(tmp_path), 0, every=10).rows).all()


@pytest.mark.usefixtures("no_repeats", "no_report")
def test_a_run_on_the_ring_is_simulated_again_without_the_ring(tmp_path: Path) -> None:
    pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")
    with skipping_without_network():
        run = run_of(tmp_path, "--plant", "emulated-ring", "--iterations", "0", "--debug")
    assert set(replay(Run(run), 0, every=100)["step"]) == {0, 1, 2, 3}


def write_log(run: Path, replayed: TickTable, iteration: int) -> None:
    """Writes the log of a rig that moves like the twin: limp, held up, hopping, landing."""
    ticks = replayed.selected(TICK_UNITS).rows
    unread = np.array([ticks[-1, 0], *[np.nan] * (len(TICK_UNITS) - 1)])
    parts = [(ticks[:30], RigState.READY), (ticks[:20], RigState.STAND), (ticks, RigState.STEP)]
    parts += [(ticks[-700:], RigState.STOP), (unread[None], RigState.FAULT)]
    rows = [rig_rows(part, state) for part, state in parts]
    path = run / "ticks" / f"ticks-{iteration}.mcap"
    path.unlink(missing_ok=True)
    with TickLog(path, LOG_UNITS) as log:
        log.append(np.concatenate(rows))


def test_ticks_of_a_rigs_log_are_separated_at_apexes(copy: Path, replayed: TickTable) -> None:
    write_log(copy, replayed, 1)
    ticks = logged_ticks(Run(copy), 1)
    assert list(ticks.units) == [*LOG_UNITS, "step"]
    held = ticks["state"] == RigState.STAND
    assert np.count_nonzero(held) == 20
    assert not ticks["step"][held].any()
    np.testing.assert_array_equal(ticks["step"][~held], replayed["step"])


def test_the_ticks_of_a_rig_that_fell_end_when_it_rests(copy: Path, replayed: TickTable) -> None:
    fallen = TickTable(replayed.units, replayed.rows[replayed["step"] <= 2][:-100])
    write_log(copy, fallen, 1)
    zero, first, second, *_ = Run(copy).recorded.of_iteration(1)
    fallen_steps = [zero, first, replace(second, record=replace(second.record, status=StepStatus.FELL))]
    ticks = logged_ticks(Run(copy, recorded=Steps(CommandBounds().space(), fallen_steps)), 1)
    assert ticks["step"][-1] == 2
    assert np.count_nonzero(ticks["state"] == RigState.STOP) == 700


@pytest.mark.parametrize("spoil", [lambda log: log.unlink(), lambda log: log.write_bytes(log.read_bytes()[:-9])])
def test_a_missing_or_incomplete_log_is_refused(
    copy: Path, replayed: TickTable, spoil: Callable[[Path], object]
) -> None:
    write_log(copy, replayed, 1)
    spoil(copy / "ticks" / "ticks-1.mcap")
    with pytest.raises(InputError, match=r"ticks-1\.mcap"):
        logged_ticks(Run(copy), 1)


def test_a_log_with_too_few_hops_is_refused(copy: Path, replayed: TickTable) -> None:
    write_log(copy, TickTable(replayed.units, replayed.rows[replayed["step"] < 2]), 1)
    with pytest.raises(InputError, match=r"ticks-1\.mcap: has fewer steps than deployment 1"):
        logged_ticks(Run(copy), 1)


# Refused


def change_a_number(run: Path) -> None:
    lines = (run / "steps.csv").read_text().splitlines(keepends=True)
    cells = lines[6].split(",")
    cells[10] = repr(float(np.nextafter(float(cells[10]), 1)))
    (run / "steps.csv").write_text("".join([*lines[:6], ",".join(cells), *lines[7:]]))


def change_number_and_version(run: Path) -> None:
    change_a_number(run)
    text = (run / "summary.json").read_text()
    (run / "summary.json").write_text(text.replace('"mujoco": "', '"mujoco": "0.'))


@pytest.mark.parametrize(
    ("spoil", "iteration", "message"),
    [
        (lambda run: None, 2, "no step of deployment 2; recorded deployments: 0, 1"),
        (lambda run: (run / "experiment.toml").unlink(), 0, "the folder contains no experiment.toml"),
        (lambda run: (run / "steps.csv").unlink(), 0, "steps.csv: No such file"),
        (change_a_number, 1, "step 1 of deployment 1 could not be reproduced exactly; the record was changed"),
        (change_number_and_version, 1, "could not be reproduced exactly; it was run with mujoco 0"),
        (
            lambda run: (run / "experiment.toml").write_text('plant = "ethercat"\n[learning]\niterations = 1\n'),
            1,
            "plant 'ethercat': a deployment of a rig cannot be simulated again",
        ),
    ],
)
def test_a_deployment_that_cannot_be_reproduced_is_refused(
    copy: Path, spoil: Callable[[Path], object], iteration: int, message: str
):
    spoil(copy)
    with pytest.raises((InputError, RecordError), match=message):
        replay(Run(copy), iteration)


def test_the_drawn_ground_is_where_the_feet_found_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """That of a simulation by place; of a rig, only where the feet stood."""
    leave_out_repeats(monkeypatch)
    leave_out_report(monkeypatch)
    run = Run(run_of(tmp_path, "--iterations", "0", "--ground.stair_height", "0.05", "--ground.stair_length", "0.1"))
    settings, scene = run.needed(run.settings), Hopper().kinematics().scene
    columns = [run.space.context_names.index(name) for name in ("foothold", "ground")]
    place, height = run.recorded.context[:, columns].T
    assert np.ptp(height) > 0.01
    treads = ground_of(run, 0, scene)
    assert treads
    turn = 2 * np.pi * scene.circle
    along = (place[:, None] - treads.start) % turn
    on = np.argmax(along < treads.end - treads.start, axis=1)
    near_an_edge = np.minimum(along[np.arange(len(on)), on], (treads.end - treads.start)[on]) < 5e-3
    np.testing.assert_allclose(treads.start_height[on][~near_an_edge], height[~near_an_edge], atol=5e-3)
    trodden = ground_of(Run(run.folder, settings=replace(settings, plant="rig")), 0, scene)
    assert trodden
    np.testing.assert_allclose((trodden.start + trodden.end) / 2, place)
    np.testing.assert_allclose(trodden.end - trodden.start, FOOTPRINT)
    np.testing.assert_array_equal(trodden.start_height, height)
