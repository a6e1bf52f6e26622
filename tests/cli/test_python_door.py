"""The experiment from Python is that of the command: same settings, same folder, same bytes."""

from importlib import import_module
from multiprocessing.spawn import get_preparation_data
from pathlib import Path

import numpy as np
import pytest

import stepgap as library
from stepgap.base.errors import InputError
from stepgap.robots.entry_points import load_robot
from tests.cli.command_line import Command

pytestmark = pytest.mark.usefixtures("package")

RECORD = ("experiment.toml", "steps.csv", "summary.json")
"""Files of a run that depend on its settings alone."""


def contents(folder: Path) -> list[str]:
    return [(folder / name).read_text() for name in RECORD]


def test_it_writes_what_the_command_writes(stepgap: Command) -> None:
    command = ("run", "--robot", "ball", "--iterations", "1", "--seed", "3", "--gap.drag", "0.2", "--quiet")
    assert stepgap(*command, "--out", "by_command").code == 0
    run = library.run("ball", out="by_python", iterations=1, seed=3, gap={"drag": np.float64(0.2)}, progress=False)
    assert contents(Path("by_python")) == contents(Path("by_command"))
    assert len(run.deployments) == 2
    assert stepgap("report", "by_python").code == 0


def test_a_robot_of_ones_own_and_targets_are_arguments(stepgap: Command) -> None:
    robot = load_robot("ball")
    targets = np.full((6, 1), robot.space.state_centre[0])
    run = library.run(robot, targets=targets, iterations=0, progress=False)
    assert np.array_equal(run.steps.target, targets)
    assert run.folder.parent == Path("runs")


def test_an_interrupted_run_goes_on(stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    library.run("ball", out="whole", iterations=1, progress=False)
    module = import_module("stepgap.cli.python_door")
    execute = module.run_experiment

    def interrupted(*arguments: object) -> None:
        execute(*arguments)
        steps = Path("broken", "steps.csv")
        steps.write_text("".join(steps.read_text().splitlines(keepends=True)[:5]))
        Path("broken", "summary.json").unlink()
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "run_experiment", interrupted)
    with pytest.raises(KeyboardInterrupt):
        library.run("ball", out="broken", iterations=1, progress=False)
    monkeypatch.setattr(module, "run_experiment", execute)
    with pytest.raises(InputError, match="already holds a run"):
        library.run("ball", out="broken", iterations=1, progress=False)
    library.run(out="broken", resume=True, progress=False)
    assert contents(Path("broken")) == contents(Path("whole"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"itrations": 1}, "itrations"),
        ({"gap": {"drag": "much"}}, r"gap\.drag"),
        ({"gap": {"drag": object()}}, r"gap\.drag: object is no setting"),
        ({"targets": [0.5, 0.6]}, r"targets: they have the shape \(2,\)"),
        ({"targets": [[np.inf]]}, "targets: "),
        ({"resume": True}, "give the run"),
        ({"resume": True, "out": "x", "seed": 1}, "own settings"),
    ],
)
def test_what_is_wrong_is_named(stepgap: Command, arguments: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        library.run(**{"robot": None if "resume" in arguments else "ball", "progress": False, **arguments})


def test_a_plant_of_ones_own_is_an_argument(stepgap: Command) -> None:
    robot = load_robot("ball")
    nominal = next(iter(robot.nominal_maps().values()))()
    run = library.run(
        "ball", plant=lambda rng: library.ModelPlant(nominal, [0.5], [0.01], rng), out="own", iterations=0
    )
    assert run.needed(run.settings).plant == "own"
    assert np.std(run.steps.next_state - run.steps.predicted) == pytest.approx(0.01, rel=0.5), "the noise of this plant"
    assert stepgap("report", "own").code == 0


def test_a_program_without_a_guard_runs_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that starts meanwhile, such as one that compiles, would run the file of the program again."""
    door = import_module("stepgap.cli.python_door")
    monkeypatch.setattr(import_module("__main__"), "__file__", "program.py", raising=False)
    found = list[dict[str, object]]()
    loop = door.run_experiment

    def observed(*arguments: object) -> None:
        found.append(get_preparation_data("other"))
        loop(*arguments)

    monkeypatch.setattr(door, "run_experiment", observed)
    library.run("ball", iterations=0, progress=False)
    assert not {"init_main_from_path", "init_main_from_name"} & set(found[0])
    assert vars(import_module("__main__"))["__file__"] == "program.py"
