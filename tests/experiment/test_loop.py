"""The experiment loop: its training data, its end, its record, and that an interruption loses nothing."""

import json
import math
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from stepgap.base.errors import StepGapError
from stepgap.base.files import write_whole
from stepgap.base.random_streams import random_stream
from stepgap.control.command_table import build_table
from stepgap.control.reference import Reference
from stepgap.control.settings import ControlSettings
from stepgap.experiment import loop
from stepgap.experiment.deployment import deploy
from stepgap.experiment.loop import Observer, Plants, Setup, run_experiment
from stepgap.experiment.outcome import estimate_noise_floor, summarise
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.gaussian_process_regression import GaussianProcessRegression
from stepgap.learning.learner import Learner
from stepgap.learning.posterior import POSTERIOR, Posterior
from stepgap.learning.residual_fit import residual_from_dict
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.plants.model_plant import ModelPlant
from stepgap.plants.plant import Plant
from stepgap.records.model_files import NominalSource, saved_model_text
from stepgap.records.steps_csv import RecordError, StepWriter, read_step_log
from stepgap.records.summary import Deployment, NoiseFloor
from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper.robot import Hopper
from stepgap.step import Array, Codes, StepMap, StepRecord, StepStatus
from tests.control.maps import LossyHopper, NeverWorks, StumblingHopper

NOMINAL = LossyHopper()
REALITY = LossyHopper(loss=0.45, keep=0.6, drift=0.09)
START = np.array([0.1, 0.55])
NOISE = np.array([0.004, 0.001])
REFERENCE = Reference.from_segments(
    ("speed", "height"), [(1, (0.1, 0.55)), (4, (0.2, 0.58)), (10, (0.1, 0.6))], steps=16
)
ALWAYS = LearningSettings("linear", iterations=2, tolerance=0.0)
GAUSSIAN = replace(ALWAYS, residual="gp_on_linear")
"""With the residual of users, which takes longer."""

MakePlant = Callable[[np.random.Generator], Plant]


def plant_of(reality: StepMap, noise: Array = NOISE) -> MakePlant:
    return lambda rng: ModelPlant(reality, START, noise, rng)


def run_in(
    folder: Path,
    make_plant: MakePlant = plant_of(REALITY),  # noqa: B008  (frozen)
    learning: LearningSettings = ALWAYS,
    nominal: StepMap = NOMINAL,
    seed: int = 3,
    observer: Observer = Observer(),  # noqa: B008  (frozen)
    replays: bool = True,
    known: Steps | None = None,
) -> list[Deployment]:
    folder.mkdir(exist_ok=True)
    setup = Setup(nominal, Plants(make_plant, replays), REFERENCE, learning, seed=seed, known=known)
    return run_experiment(setup, folder, observer)


def contents(folder: Path) -> dict[str, bytes]:
    """The files of a run, without the rows that a lost summary counted."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != "steps.csv.before"]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("unbroken")
    run_in(folder)
    return folder


@pytest.fixture(scope="module")
def gaussian(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As `unbroken`, with Gaussian processes."""
    folder = tmp_path_factory.mktemp("gaussian")
    run_in(folder, learning=GAUSSIAN)
    return folder


@pytest.fixture(scope="module")
def warm(unbroken: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that knows the steps of `unbroken` from the beginning."""
    folder = tmp_path_factory.mktemp("warm")
    run_in(folder, known=read_step_log(unbroken / "steps.csv", NOMINAL.space), seed=7)
    return folder


@pytest.fixture
def copy(unbroken: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(unbroken, tmp_path / "copy"))


def in_space(steps: list[LoggedStep]) -> Steps:
    return Steps(NOMINAL.space, steps)


def logged(number: int, target: tuple[float, float], next_state: tuple[float, float] | None) -> LoggedStep:
    status = StepStatus.OK if next_state else StepStatus.FELL
    after = np.array(next_state or (math.nan, math.nan))
    record = StepRecord(START, np.zeros(2), np.zeros(2), after, status)
    return LoggedStep(0, number, np.array(target), np.array(target), np.zeros(2), record)


# Errors


def test_the_errors_of_a_deployment_by_hand() -> None:
    reference = Reference(("speed", "height"), np.array([[0.0, 0.5]] * 2 + [[0.2, 0.6]] * 6))
    errors = [(9.0, 9.0), (-0.1, 0.02), (0.3, 0.0), (0.1, 0.04), (0.0, 0.0), (0.0, 0.0), (0.02, -0.03), None]
    steps = [
        logged(number, target, error and (target[0] + error[0], target[1] + error[1]))
        for number, (target, error) in enumerate(zip(map(tuple, reference.targets.tolist()), errors, strict=True), 1)
    ]
    found = summarise(in_space(steps), reference, "none")
    assert (found.iteration, found.residual, found.steps, found.failed_steps) == (0, "none", 8, 1)
    squares = (81 + 0.01 + 0.09 + 0.01 + 0.0004, 81 + 0.0004 + 0.0016 + 0.0009)
    assert found.rmse == pytest.approx([math.sqrt(square / 7) for square in squares])
    assert found.mae == pytest.approx([(9 + 0.1 + 0.3 + 0.1 + 0.02) / 7, (9 + 0.02 + 0.04 + 0.03) / 7])
    assert found.bias == pytest.approx([(9 - 0.1 + 0.3 + 0.1 + 0.02) / 7, (9 + 0.02 + 0.04 - 0.03) / 7])
    # The target changes with step 3: transient are 3 to 6, steady 7 and the fallen 8, neither 1 and 2.
    assert found.transient_rmse == pytest.approx([math.sqrt((0.09 + 0.01) / 4), math.sqrt(0.0016 / 4)])
    assert found.steady_rmse == pytest.approx([0.02, 0.03])


def test_without_a_completed_step_there_is_no_error() -> None:
    found = summarise(in_space([logged(1, (0.1, 0.55), None)]), REFERENCE, "none")
    assert (found.steps, found.failed_steps) == (1, 1)
    for measure in (found.rmse, found.mae, found.bias, found.steady_rmse, found.transient_rmse):
        assert np.isnan(measure).all()
        assert measure.shape == (2,)


def test_the_noise_floor_is_the_noise_of_the_plant() -> None:
    reference = Reference.from_segments(("speed", "height"), [(1, (0.1, 0.55)), (2, (0.2, 0.58))], steps=600)
    plant = plant_of(REALITY)(np.random.default_rng(1))
    steps = list(deploy(Learner.start(NOMINAL, in_space([]), ALWAYS, 0), plant, reference, 0))
    assert estimate_noise_floor(in_space(steps), reference).any_phase == pytest.approx(NOISE, rel=0.05)
    assert np.isnan(estimate_noise_floor(in_space(steps[:9]), reference).any_phase).all(), (
        "5 coefficients cannot be estimated from 4 steady steps"
    )
    assert np.isnan(estimate_noise_floor(in_space([]), reference).any_phase).all()


# Learning


def test_every_model_is_learned_on_the_nominal_map_from_all_steps(gaussian: Path) -> None:
    log = read_step_log(gaussian / "steps.csv", NOMINAL.space)
    for iteration in (1, 2):
        before = Steps(log.space, [logged for logged in log if logged.iteration < iteration])
        residual = residual_from_dict(json.loads((gaussian / "models" / f"iteration_{iteration}.json").read_text()))
        for column, regression in enumerate(residual.regressions):
            assert isinstance(regression, GaussianProcessRegression)
            process = regression.process
            np.testing.assert_array_equal(process.points, np.hstack([before.state, before.requested]))
            nominal = NOMINAL.evaluate(before.state, before.requested).next_state
            np.testing.assert_array_equal(process.values, (before.next_state - nominal)[:, column])


def test_learning_closes_the_gap(tmp_path: Path) -> None:
    first, *_, last = run_in(tmp_path, plant_of(REALITY, np.zeros(2)), GAUSSIAN)
    assert (last.rmse < 0.3 * first.rmse).all()


def test_nothing_learned_leaves_the_nominal_map() -> None:
    assert Learner.start(NOMINAL, in_space([]), ALWAYS, 1).residual.kind == "none"
    failing = in_space([logged(1, (0.1, 0.5), (0.1, 0.5))])
    assert Learner.start(NeverWorks(), failing, ALWAYS, 1).residual.kind == "none"


def test_the_residual_that_predicts_best_is_named(tmp_path: Path) -> None:
    done = run_in(tmp_path, learning=LearningSettings("auto", iterations=2, tolerance=0.0))
    for deployment in done[1:]:
        saved = json.loads((tmp_path / "models" / f"iteration_{deployment.iteration}.json").read_text())
        assert deployment.residual == saved["kind"] not in ("auto", "none")


# End of redeployment


def deployment(speed: float, height: float = 0.0, failed_steps: int = 0) -> Deployment:
    errors = np.array([speed, height])
    none = np.empty((0, 2))
    return Deployment(0, "gp", 10, failed_steps, errors, errors, errors, errors, errors, errors, 0, none, none)


@pytest.mark.parametrize(
    ("errors", "goes_on"),
    [
        ([0.1], True),
        ([0.1, 0.2], True),  # the first redeployment may be worse
        ([0.1, 0.2, 0.0989], True),
        ([0.1, 0.2, 0.0991], False),
        ([0.1, 0.05, 0.07], False),
        ([0.1, math.inf, 0.05], True),
        ([0.1, 0.05, math.inf], True),  # an aborted one does not show how well it could track
        ([math.inf, math.inf, math.inf], False),  # each after as many steps as the one before
    ],
)
def test_when_redeploying_is_worth_it(errors: list[float], goes_on: bool) -> None:
    done = [deployment(0.0 if math.isinf(error) else error, failed_steps=int(math.isinf(error))) for error in errors]
    assert loop._still_improves(done, np.array([1.0, 1.0]), tolerance=0.01) is goes_on


@pytest.mark.parametrize(
    ("steps", "goes_on"), [((3, 5, 9), True), ((9, 5, 9), False), ((9, 10, 5), False), ((3, 3), True)]
)
def test_failures_are_repeated_only_as_long_as_they_come_later(steps: tuple[int, ...], goes_on: bool) -> None:
    done = [replace(deployment(0.0, failed_steps=1), steps=count) for count in steps]
    assert loop._still_improves(done, np.array([1.0, 1.0]), tolerance=0.01) is goes_on


def test_it_stops_when_nothing_is_gained(tmp_path: Path) -> None:
    done = run_in(tmp_path, learning=LearningSettings(iterations=9, tolerance=0.9))
    assert [deployment.iteration for deployment in done] == [0, 1, 2]
    assert len(list((tmp_path / "models").iterdir())) == 2
    before = contents(tmp_path)
    run_in(tmp_path, learning=LearningSettings(iterations=9, tolerance=0.9))
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    "wrong",
    [
        {"residual": "cubic"},
        {"iterations": -1},
        {"iterations": 1001},
        {"iterations": 1.5},
        {"exploration": True},
        {"early_stop": 1},
        {"residual": 3},
        {"tolerance": 1.0},
        {"tolerance": math.nan},
        {"forgetting_time": 0.0},
        {"forgetting_time": math.nan},
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict) -> None:
    (name,) = wrong
    with pytest.raises(ValueError, match=f"^{name} = .*but it must"):
        LearningSettings(**wrong)


# Record


def test_redeploying_in_any_case(tmp_path: Path) -> None:
    done = run_in(tmp_path, learning=LearningSettings(iterations=3, tolerance=0.9, early_stop=False))
    assert len(done) == 4
    assert len(run_in(tmp_path / "b", learning=LearningSettings(iterations=3, tolerance=0.9))) == 3


def test_a_deployment_by_table_uses_the_corrected_map(tmp_path: Path) -> None:
    learning = LearningSettings(iterations=1, drift=False)
    control = ControlSettings(cautious=False, viability=False, avoid_failures=False, table=3)
    run_experiment(Setup(NOMINAL, Plants(plant_of(REALITY)), REFERENCE, learning, control, 3), tmp_path)
    log = read_step_log(tmp_path / "steps.csv", NOMINAL.space)
    residual = Learner.start(NOMINAL, log.of_iteration(0), learning, 1).residual
    for number, step_map in enumerate((NOMINAL, CorrectedMap(NOMINAL, residual))):
        table = build_table(step_map, 3)
        plans = [
            (logged.record.command, table(logged.record.state, logged.target)) for logged in log.of_iteration(number)
        ]
        of_table = [
            (command, plan.command) for command, plan in plans if plan.reached
        ]  # elsewhere the controller solves
        assert len(of_table) >= 3
        for command, wanted in of_table:
            np.testing.assert_allclose(command, wanted, rtol=1e-12)


def test_the_folder_is_the_contract(unbroken: Path) -> None:
    assert sorted(contents(unbroken)) == [
        "models/iteration_1.json", "models/iteration_2.json", "steps.csv", "summary.json"
    ]  # fmt: skip
    summary = json.loads((unbroken / "summary.json").read_text())
    assert {"schema", "seed", "iterations", "repeatability"} <= set(summary)
    assert (summary["schema"], summary["seed"]) == (1, 3)
    for number, entry in enumerate(summary["iterations"]):
        measures = {"rmse", "mae", "bias", "steady_rmse", "transient_rmse", "true_rmse"}
        assert set(entry) == {
            "iteration",
            "residual",
            "steps",
            "falls",
            "cut",
            "unreachable",
            "missed",
            "alarms",
            *measures,
        }
        residual = "linear" if number else "none"
        assert [entry[key] for key in ("iteration", "residual", "steps", "falls")] == [number, residual, 16, 0]
        assert all(set(entry[measure]) == {"speed", "height"} for measure in measures)
    assert set(summary["repeatability"]) == {"speed", "height"}
    assert summary["repeatability_measured"] is False


def test_the_summary_agrees_with_the_steps(unbroken: Path) -> None:
    log = read_step_log(unbroken / "steps.csv", NOMINAL.space)
    summary = json.loads((unbroken / "summary.json").read_text())
    for entry in summary["iterations"]:
        found = summarise(log.of_iteration(entry["iteration"]), REFERENCE, entry["residual"])
        assert list(entry["rmse"].values()) == found.rmse.tolist()
        assert list(entry["steady_rmse"].values()) == found.steady_rmse.tolist()
        assert entry["true_rmse"] == entry["rmse"], "the state of a map is measured without error"
        assert entry["missed"] == found.missed.tolist()
        assert entry["alarms"] == []


def test_same_seed_same_bytes_other_seed_others(unbroken: Path, gaussian: Path, tmp_path: Path) -> None:
    run_in(tmp_path / "same", learning=GAUSSIAN)
    run_in(tmp_path / "other", seed=4)
    assert contents(tmp_path / "same") == contents(gaussian)
    assert contents(tmp_path / "other")["steps.csv"] != contents(unbroken)["steps.csv"]


def test_a_measured_noise_floor_is_recorded_and_measured_once(tmp_path: Path) -> None:
    calls: list[tuple[StepMap, float]] = []

    def measure(step_map: StepMap, rng: np.random.Generator, progress: Callable[[int, int], None]) -> NoiseFloor:
        calls.append((step_map, rng.random()))
        return NoiseFloor(np.array([0.003, np.nan]), np.array([0.002, 0.001]))

    for _ in range(2):
        plants = Plants(plant_of(REALITY), measure_noise_floor=measure)
        run_experiment(Setup(NOMINAL, plants, REFERENCE, ALWAYS, seed=3), tmp_path)
        summary = json.loads((tmp_path / "summary.json").read_text())
        assert summary["repeatability"] == {"speed": 0.003, "height": None}
        assert summary["repeatability_same_yaw"] == {"speed": 0.002, "height": 0.001}
        assert summary["repeatability_measured"] is True
    ((step_map, drawn),) = calls
    assert isinstance(step_map, CorrectedMap)
    assert drawn == random_stream(3, 2, 1).random()
    learned = json.loads((tmp_path / "models" / "iteration_2.json").read_text())
    bases = [each.base for each in step_map.residual.regressions if isinstance(each, Posterior)]
    assert [base.to_dict() for base in bases if base] == learned["regressions"]


def test_the_noise_floor_is_measured_under_the_same_map_after_an_interruption(tmp_path: Path) -> None:
    """The map is that at the end of the last deployment, with the disturbance estimated so far, also after a resume."""
    maps: list[CorrectedMap] = []

    def measure(step_map: StepMap, rng: np.random.Generator, progress: Callable[[int, int], None]) -> NoiseFloor:
        assert isinstance(step_map, CorrectedMap)
        maps.append(step_map)
        if len(maps) == 1:
            raise KeyboardInterrupt
        return NoiseFloor(np.array([0.003, 0.001]), np.array([0.002, 0.001]))

    def go(folder: Path) -> bytes:
        folder.mkdir(exist_ok=True)
        plants = Plants(plant_of(REALITY), measure_noise_floor=measure)
        run_experiment(Setup(NOMINAL, plants, REFERENCE, replace(GAUSSIAN, iterations=1), seed=3), folder)
        return (folder / "summary.json").read_bytes()

    with pytest.raises(KeyboardInterrupt):
        go(tmp_path / "interrupted")
    assert go(tmp_path / "interrupted") == go(tmp_path / "whole")
    point = np.array([0.15, 0.57]), np.array([1.0, 2.0])
    _, resumed, whole = (step_map(*point).tolist() for step_map in maps)
    assert resumed == whole


def test_every_step_is_on_disk_before_it_is_reported(tmp_path: Path) -> None:
    reported = []

    def on_step(logged: LoggedStep) -> None:
        reported.append(logged)
        assert len(read_step_log(tmp_path / "steps.csv", NOMINAL.space)) == len(reported)

    run_in(tmp_path, observer=Observer(on_step=on_step))
    assert len(reported) == 48


def test_a_file_is_written_whole(tmp_path: Path) -> None:
    (tmp_path / "a.json.partial").write_text("left over, and longer than what comes")
    write_whole(tmp_path / "a.json", "new")
    assert contents(tmp_path) == {"a.json": b"new"}


# Steps known before


def test_known_steps_are_used_from_the_first_deployment_on(unbroken: Path, warm: Path) -> None:
    cold = json.loads((unbroken / "summary.json").read_text())["iterations"]
    summary = json.loads((warm / "summary.json").read_text())
    done = summary["iterations"]
    assert [entry["residual"] for entry in cold] == ["none", "linear", "linear"]
    assert [entry["residual"] for entry in done] == ["linear"] * 3
    for name, error in cold[0]["rmse"].items():
        assert done[0]["rmse"][name] < 0.4 * error, "only the noise remains"
    log = read_step_log(warm / "steps.csv", NOMINAL.space)
    assert log.iterations == [0, 1, 2], "known steps are not recorded as steps of this run"
    assert summary["warm_start"]["steps"] == 48


def test_errors_of_known_steps_are_those_of_this_nominal_map(unbroken: Path, tmp_path: Path) -> None:
    known, other = read_step_log(unbroken / "steps.csv", NOMINAL.space), LossyHopper(loss=0.3, drift=-0.05)
    done = run_in(tmp_path / "warm", known=known, nominal=other)
    cold = run_in(tmp_path / "cold", nominal=other)
    assert (done[0].rmse < 0.25 * cold[0].rmse).all()
    model = residual_from_dict(json.loads((tmp_path / "warm" / "models" / "iteration_0.json").read_text()))
    point = np.array([0.15, 0.57, 1.0, 2.0])
    truth = REALITY.evaluate(point[:2], point[2:]).next_state - other.evaluate(point[:2], point[2:]).next_state
    assert model.mean(point) == pytest.approx(truth, abs=0.01)


def test_a_run_with_known_steps_is_resumed(unbroken: Path, warm: Path, tmp_path: Path) -> None:
    known = read_step_log(unbroken / "steps.csv", NOMINAL.space)
    shutil.copytree(warm, tmp_path / "warm")
    whole = contents(tmp_path / "warm")
    for rows in (5, 20):
        rows_kept(tmp_path / "warm", rows)
        run_in(tmp_path / "warm", known=known, seed=7)
        (tmp_path / "warm" / "steps.csv.before").unlink(missing_ok=True)
        assert contents(tmp_path / "warm") == whole
    for other in (None, known.of_iteration(0)):
        with pytest.raises(RecordError, match="settings"):
            run_in(tmp_path / "warm", known=other, seed=7)


# Falls


def test_a_fall_ends_the_deployment_and_the_next_one_starts(tmp_path: Path) -> None:
    falls_often = StumblingHopper(fall_line=-0.1, least_force=-19.0)
    done = run_in(tmp_path, plant_of(falls_often))
    log = read_step_log(tmp_path / "steps.csv", NOMINAL.space)
    assert [deployment.iteration for deployment in done] == [0, 1, 2]
    for deployment in done:
        steps = log.of_iteration(deployment.iteration)
        assert deployment.failed_steps == 1
        assert deployment.steps == len(steps) > 1
        error = steps.completed().next_state - steps.completed().target
        assert deployment.rmse == pytest.approx(np.sqrt(np.mean(error**2, axis=0)))
    before = contents(tmp_path)
    run_in(tmp_path, plant_of(falls_often))
    assert contents(tmp_path) == before


def test_a_plant_that_falls_at_every_first_step(tmp_path: Path) -> None:
    done = run_in(tmp_path, plant_of(NeverWorks()))
    assert [(d.iteration, d.steps, d.failed_steps, d.residual) for d in done] == [(k, 1, 1, "none") for k in range(3)]
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["iterations"][2]["rmse"] == {"speed": None, "height": None}
    assert summary["repeatability"] == {"speed": None, "height": None}
    before = contents(tmp_path)
    run_in(tmp_path, plant_of(NeverWorks()))
    assert contents(tmp_path) == before


@dataclass(frozen=True)
class FallsAfter(LossyHopper):
    """Falls as soon as it is fast, so that a deployment has few steps."""

    fastest: float = 0.15

    def status(self, state: Array, command: Array) -> Codes:
        shape = np.broadcast_shapes(state.shape[:-1], command.shape[:-1])
        return np.broadcast_to(np.where(state[..., 0] > self.fastest, StepStatus.FELL, StepStatus.OK), shape)


@pytest.mark.parametrize("fastest", [0.11, 0.15, 0.19])
def test_few_steps_are_enough_to_learn_something(tmp_path: Path, fastest: float) -> None:
    done = run_in(tmp_path, plant_of(FallsAfter(fastest=fastest)), GAUSSIAN)
    assert [d.residual for d in done] == ["none", "gp_on_linear", "gp_on_linear"]
    assert all(d.failed_steps == 1 and d.steps > 1 for d in done)


def test_a_nominal_map_that_knows_no_step_still_commands(tmp_path: Path) -> None:
    done = run_in(tmp_path, nominal=NeverWorks())
    log = read_step_log(tmp_path / "steps.csv", NOMINAL.space)
    assert all(d.steps == 16 for d in done)
    assert np.isnan(log.predicted).all()
    assert all((logged.record.command == 0).all() for logged in log)


def test_a_nominal_map_with_failing_regions(tmp_path: Path) -> None:
    nominal = StumblingHopper(drift=0.03, loss=0.42)
    done = run_in(tmp_path, plant_of(StumblingHopper()), GAUSSIAN, nominal)
    assert (done[-1].rmse < done[0].rmse).all()


# Interrupted and resumed


class Killed(BaseException):
    """Simulates the death of the process."""


def test_a_run_killed_after_any_step_gives_the_same_result(gaussian: Path, tmp_path: Path) -> None:
    for last in (16, 47):
        folder, count = tmp_path / str(last), iter(range(1, 100))

        def on_step(logged: LoggedStep, last: int = last, count: Iterator[int] = count) -> None:
            if next(count) == last:
                raise Killed

        with pytest.raises(Killed):
            run_in(folder, learning=GAUSSIAN, observer=Observer(on_step=on_step))
        assert len(read_step_log(folder / "steps.csv", NOMINAL.space)) == last
        run_in(folder, learning=GAUSSIAN)
        assert contents(folder) == contents(gaussian)


def test_an_interrupted_deployment_of_hardware_is_kept_and_the_next_one_starts(tmp_path: Path) -> None:
    luck = np.random.default_rng(8)  # hardware does not repeat itself

    def make_plant(rng: np.random.Generator) -> Plant:
        return ModelPlant(REALITY, START, NOISE, luck)

    count = iter(range(1, 100))

    def on_step(logged: LoggedStep) -> None:
        if next(count) == 21:
            raise Killed

    with pytest.raises(Killed):
        run_in(tmp_path, make_plant, observer=Observer(on_step=on_step), replays=False)
    before = (tmp_path / "steps.csv").read_text()
    rows_kept(tmp_path, 21, "1,6,0.")  # the process died while it wrote
    deployments = run_in(tmp_path, make_plant, replays=False)
    assert (tmp_path / "steps.csv").read_text().startswith(before)
    assert [(deployment.iteration, deployment.steps) for deployment in deployments] == [(0, 16), (1, 5), (2, 16)]
    again = run_in(tmp_path, lambda rng: pytest.fail("all is done"), replays=False)
    assert [deployment.steps for deployment in again] == [16, 5, 16]


def test_a_fault_of_the_plant_is_reported(tmp_path: Path) -> None:
    class EmptyBattery(ModelPlant):
        @property
        def fault(self) -> str:
            return "the battery is empty"

    faults: list[str] = []
    run_in(tmp_path, lambda rng: EmptyBattery(REALITY, START, NOISE, rng), observer=Observer(on_fault=faults.append))
    assert faults == ["the battery is empty"] * 3


def rows_kept(folder: Path, count: int, rest: str = "") -> None:
    lines = (folder / "steps.csv").read_text().splitlines(keepends=True)
    (folder / "steps.csv").write_text("".join(lines[: count + 1]) + rest)


BREAKS: dict[str, Callable[[Path], object]] = {
    "after the header": lambda folder: rows_kept(folder, 0),
    "in the middle of the header": lambda folder: (folder / "steps.csv").write_text("iteration,st"),
    "in the middle of the first row": lambda folder: rows_kept(folder, 0, "0,1,0.1,0.5"),
    "in the middle of a row": lambda folder: rows_kept(folder, 20, "1,5,0."),
    "in the middle of a number that could be whole": lambda folder: rows_kept(folder, 5, "0"),
    "after a step": lambda folder: rows_kept(folder, 5),
    "at the end of a deployment": lambda folder: rows_kept(folder, 16),
    "at the first step of a deployment": lambda folder: rows_kept(folder, 17),
    "between steps and summary": lambda folder: (folder / "summary.json").unlink(),
    "models are missing": lambda folder: shutil.rmtree(folder / "models"),
    "a model is damaged": lambda folder: (folder / "models" / "iteration_1.json").write_text('{"schema": 1'),
    "a model is missing": lambda folder: (folder / "models" / "iteration_1.json").unlink(),
    "a summary was being written": lambda folder: (folder / "summary.json.partial").write_text('{"sch'),
    "a summary was cut off": lambda folder: (folder / "summary.json").write_text('{"schema": 1, "seed"'),
    "a summary of something else": lambda folder: (folder / "summary.json").write_text('["iterations"]'),
    "no byte": lambda folder: (folder / "steps.csv").write_bytes(b""),
    "no steps at all": lambda folder: (folder / "steps.csv").unlink(),
    "nothing at all": lambda folder: (shutil.rmtree(folder), folder.mkdir()),
}


WITHOUT_SUMMARY = (
    "between steps and summary",
    "a summary was cut off",
    "a summary of something else",
    "nothing at all",
)
"""Breaks after which it makes no difference that the summary is missing, too."""


@pytest.mark.parametrize(
    ("point", "with_summary"),
    [*((point, True) for point in BREAKS), *((point, False) for point in BREAKS if point not in WITHOUT_SUMMARY)],
)
def test_a_run_interrupted_at_any_point_gives_the_same_result(
    copy: Path, unbroken: Path, point: str, with_summary: bool
) -> None:
    BREAKS[point](copy)
    if not with_summary:
        (copy / "summary.json").unlink(missing_ok=True)
    run_in(copy)
    assert contents(copy) == contents(unbroken)


def test_rows_that_a_lost_summary_counted_are_kept(copy: Path) -> None:
    before = contents(copy)["steps.csv"]
    (copy / "summary.json").unlink()
    run_in(copy, seed=4)
    assert contents(copy)["steps.csv"] != before
    assert (copy / "steps.csv.before").read_bytes() == before


def counting(make_plant: MakePlant, made: list[int]) -> MakePlant:
    def make(rng: np.random.Generator) -> Plant:
        made.append(1)
        return make_plant(rng)

    return make


def test_finished_deployments_are_not_run_again(unbroken: Path, tmp_path: Path) -> None:
    made: list[int] = []
    for iterations in (1, 1, 2):
        learning = replace(ALWAYS, iterations=iterations)
        run_in(tmp_path / "run", counting(plant_of(REALITY), made), learning=learning)
    assert len(made) == 3, "two deployments, none again, and one more"
    assert contents(tmp_path / "run")["steps.csv"] == contents(unbroken)["steps.csv"]


def change_number(line: int, column: int) -> Callable[[Path], None]:
    """Changes one number in its last bit."""

    def change(lines: list[str]) -> list[str]:
        cells = lines[line].split(",")
        cells[column] = repr(float(np.nextafter(float(cells[column]), np.inf)))
        return [*lines[:line], ",".join(cells), *lines[line + 1 :]]

    return change_lines(change)


def change_lines(change: Callable[[list[str]], list[str]]) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        path = folder / "steps.csv"
        path.write_text("".join(change(path.read_text().splitlines(keepends=True))))

    return spoil


TAMPERED: dict[str, Callable[[Path], None]] = {
    **{
        f"number changed in line {line + 1}, column {column + 1}": change_number(line, column)
        for line, column in [(1, 2), (3, 4), (5, 6), (9, 8), (16, 10), (16, 11), (20, 12), (40, 14), (48, 9)]
    },
    "gap": change_lines(lambda lines: lines[:7] + lines[8:]),
    "row twice": change_lines(lambda lines: [*lines[:7], lines[6], *lines[7:]]),
    "rows exchanged": change_lines(lambda lines: [*lines[:7], lines[8], lines[7], *lines[9:]]),
    "an earlier deployment is missing": change_lines(lambda lines: [*lines[:17], *lines[33:]]),
    "only a later deployment": change_lines(lambda lines: [lines[0], *lines[17:]]),
    "an earlier deployment is cut short": change_lines(lambda lines: [*lines[:12], *lines[17:]]),
    "one deployment too many": change_lines(
        lambda lines: [*lines, *(line.replace("2,", "3,", 1) for line in lines[33:])]
    ),
    "a deployment too long": change_lines(lambda lines: [*lines, lines[-1].replace("2,16,", "2,17,", 1)]),
    "other columns": change_lines(lambda lines: [lines[0].replace("speed", "pace"), *lines[1:]]),
}


@pytest.mark.parametrize("spoil", TAMPERED.values(), ids=TAMPERED)
def test_a_record_that_was_tampered_with_is_refused_or_made_again(copy: Path, unbroken: Path, spoil: Callable) -> None:
    spoil(copy)
    before = contents(copy)
    try:
        run_in(copy)
    except RecordError:
        assert contents(copy) == before
    else:
        assert contents(copy) == contents(unbroken)


def test_a_changed_step_that_the_summary_counts_is_refused(copy: Path) -> None:
    change_number(20, 12)(copy)
    before = contents(copy)
    with pytest.raises(RecordError, match=r"steps\.csv: its steps are not those that summary\.json counts"):
        run_in(copy)
    assert contents(copy) == before


def test_an_interrupted_deployment_begins_again_from_its_seed(copy: Path, unbroken: Path) -> None:
    rows_kept(copy, 40)
    summary = json.loads((copy / "summary.json").read_text())
    kept = (unbroken / "steps.csv").read_text().splitlines(keepends=True)[:33]
    (copy / "summary.json").unlink()
    run_in(copy, learning=replace(ALWAYS, iterations=1))
    assert (copy / "steps.csv").read_text() == "".join(kept)
    rows_kept(copy, 32, "".join((unbroken / "steps.csv").read_text().splitlines(keepends=True)[33:41]))
    made: list[int] = []
    run_in(copy, counting(plant_of(REALITY), made))
    assert len(made) == 1, "the last of three deployments"
    assert json.loads((copy / "summary.json").read_text()) == summary
    assert contents(copy) == contents(unbroken)


def test_other_settings_are_refused(copy: Path) -> None:
    before = contents(copy)
    for resumed in (
        lambda: run_in(copy, seed=4),
        lambda: run_in(copy, learning=replace(ALWAYS, iterations=1)),
    ):
        with pytest.raises(RecordError, match="settings"):
            resumed()
        assert contents(copy) == before


def test_a_model_of_recorded_steps_is_not_overwritten(copy: Path) -> None:
    before = contents(copy)
    run_in(copy, learning=replace(ALWAYS, residual="quadratic", iterations=3, early_stop=False), replays=False)
    after = contents(copy)
    kept = [name for name in before if "iteration_" in str(name)]
    assert len(kept) == 2
    assert [after[name] for name in kept] == [before[name] for name in kept]
    assert set(after) - set(before) == {"models/iteration_3.json"}


def test_a_run_is_not_continued_with_another_nominal_map(copy: Path) -> None:
    before = contents(copy)
    with pytest.raises(RecordError, match=r"iteration_1\.json.*nominal map.*--warm-start"):
        run_in(copy, learning=replace(ALWAYS, iterations=3), nominal=LossyHopper(loss=0.3), replays=False)
    assert contents(copy) == before


def test_hardware_does_not_take_lost_steps_again(copy: Path) -> None:
    for rows in (40, 16, 0):
        rows_kept(copy, rows)
        before = contents(copy)
        message = rf"summary\.json has 3 deployments with 48 steps, but steps\.csv only {rows} steps"
        with pytest.raises(RecordError, match=message):
            run_in(copy, replays=False)
        assert contents(copy) == before


@pytest.mark.parametrize("online", [False, True])
def test_a_further_deployment_begins_as_the_run_goes_on(tmp_path: Path, online: bool) -> None:
    """What `Run` learns from all steps is what the loop learned, to the last bit."""
    learning = LearningSettings(iterations=2, tolerance=0.0, online=online)
    run_in(tmp_path, learning=learning)
    written = (tmp_path / "models" / "iteration_2.json").read_text()
    (tmp_path / "models" / "iteration_2.json").unlink()
    (tmp_path / "summary.json").unlink()
    rows_kept(tmp_path, 32)
    found = Run(tmp_path, nominal=NOMINAL, settings=Experiment(Hopper(), learning=learning, prior="none")).learner()
    assert found.iteration == 2
    assert found.learned.kind == POSTERIOR.name
    assert saved_model_text(found.learned, NOMINAL.space, NominalSource("map", NOMINAL), found.beliefs) == written


def test_one_process_at_a_time(copy: Path) -> None:
    with StepWriter(copy / "steps.csv", NOMINAL.space), pytest.raises(RecordError, match="another process"):
        run_in(copy)


class FailingPlant(ModelPlant):
    """A plant that fails at the start or at a step; it records whether it was stopped."""

    def __init__(self, fails_at: int, stopped: list[bool]):
        super().__init__(REALITY, START, NOISE, random_stream(3, 0))
        self._left, self._stopped = fails_at, stopped

    def start(self) -> Array:
        if self._left == 0:
            raise RigFault("no drive answers")
        return super().start()

    def take_step(self, command: Array) -> StepRecord:
        self._left -= 1
        if self._left == 0:
            raise RigFault("a drive tripped")
        return super().take_step(command)

    def stop(self) -> None:
        self._stopped.append(True)


@pytest.mark.parametrize("fails_at", [0, 5])
def test_a_run_with_a_failed_rig_can_be_resumed(tmp_path: Path, unbroken: Path, fails_at: int) -> None:
    stopped: list[bool] = []
    with pytest.raises(RigFault):
        run_in(tmp_path, lambda rng: FailingPlant(fails_at, stopped))
    assert stopped
    assert len(read_step_log(tmp_path / "steps.csv", NOMINAL.space)) == max(0, fails_at - 1)
    run_in(tmp_path)
    assert contents(tmp_path) == contents(unbroken)


class LosingSight(ModelPlant):
    """A plant that measures no state at its start, or after a step."""

    def __init__(self, lost_after: int):
        super().__init__(REALITY, START, NOISE, random_stream(3, 0))
        self._left = lost_after

    def start(self) -> Array:
        return super().start() if self._left else np.full(2, np.nan)

    def take_step(self, command: Array) -> StepRecord:
        self._left -= 1
        record = super().take_step(command)
        return record if self._left else replace(record, next_state=np.full(2, np.nan))


@pytest.mark.parametrize(
    ("lost_after", "message"),
    [(0, "the first state of the plant is"), (5, "step 5 of deployment 0 cannot be recorded")],
)
def test_a_plant_without_a_state_loses_no_step(tmp_path: Path, unbroken: Path, lost_after: int, message: str) -> None:
    with pytest.raises(StepGapError, match=message):
        run_in(tmp_path, lambda rng: LosingSight(lost_after))
    assert len(read_step_log(tmp_path / "steps.csv", NOMINAL.space)) == max(0, lost_after - 1)
    run_in(tmp_path)
    assert contents(tmp_path) == contents(unbroken)


def test_an_error_anywhere_stops_the_plant_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped: list[bool] = []

    def disk_full(*_: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(StepWriter, "append", disk_full)
    try:
        run_in(tmp_path, lambda rng: FailingPlant(99, stopped))
    except OSError:
        assert stopped, "before the error is handled"
    else:
        pytest.fail("the error was lost")


def test_a_reference_for_another_map_is_refused(tmp_path: Path) -> None:
    reference = Reference(("pace", "height"), REFERENCE.targets)
    with pytest.raises(ValueError, match="the reference has targets of pace"):
        run_experiment(Setup(NOMINAL, Plants(plant_of(REALITY)), reference, ALWAYS), tmp_path)
    assert not contents(tmp_path)


def test_a_deployment_is_named_by_what_learned_in_it() -> None:
    """Without a step, only beliefs learn while it goes on, whatever residual is fitted afterwards."""
    settings = LearningSettings("gp", online=True)
    assert loop._residual_name(Learner.start(NOMINAL, Steps(NOMINAL.space), settings, 0)) == POSTERIOR.name
    alone = replace(settings, drift=False)
    assert loop._residual_name(Learner.start(NOMINAL, Steps(NOMINAL.space), alone, 0)) == "gp"
