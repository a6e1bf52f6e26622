"""Every setting has a meaning, the commented file is read back as the same experiment, and the page is current."""

import tomllib
from pathlib import Path

import pytest

from stepgap.experiment.settings import Experiment, experiment_table, read_experiment
from stepgap.experiment.settings_text import described_settings, experiment_toml, meanings, settings_page
from stepgap.robots.entry_points import load_robot
from stepgap.step import ContextQuantity
from tests.cli.command_line import Command

PAGE = Path(__file__).parents[2] / "docs" / "settings.md"
ROBOTS = ("hopper", "quadruped", "monopod", "velocity")


@pytest.fixture(params=ROBOTS)
def experiment(request: pytest.FixtureRequest) -> Experiment:
    return Experiment(load_robot(request.param))


def test_every_setting_has_a_meaning(experiment: Experiment) -> None:
    described = list(described_settings(experiment))
    assert not [name for name, text, _ in described if not text]
    names = [name for name, _, _ in described]
    assert len(names) == len(set(names))
    for name, _, value in described:
        if value is not None:
            found = experiment_table(experiment)
            for key in name.split("."):
                found = found[key]
            assert found == value, name
    lines = [line for line in experiment_toml(experiment).splitlines() if " = " in line and line[0] != "#"]
    assert len(lines) == sum(value is not None and value != {} for _, _, value in described)


def test_the_commented_file_is_read_back(experiment: Experiment, tmp_path: Path) -> None:
    path = tmp_path / "experiment.toml"
    path.write_text(experiment_toml(experiment), encoding="utf-8")
    assert read_experiment(path) == experiment
    assert max(map(len, path.read_text("utf-8").splitlines())) <= 120


def test_a_meaning_may_be_that_of_a_base_class() -> None:
    assert meanings(type(load_robot("quadruped"))).keys() >= {"gap", "gains", "tick"}


def test_the_page_is_current() -> None:
    assert PAGE.read_text("utf-8") == settings_page((*ROBOTS, "policy")), (
        "write it by `./go python docs/settings_page.py`"
    )


def test_the_verb_prints_a_file_of_settings(stepgap: Command) -> None:
    result = stepgap("settings", "--robot", "quadruped", "--gap.payload", "2.5")
    assert (result.code, result.err) == (0, "")
    assert tomllib.loads(result.out)["gap"]["payload"] == 2.5
    assert "# Mass added to the first body [kg]. No gap: 0.0.\npayload = 2.5\n" in result.out
    Path("e.toml").write_text(result.out)
    assert stepgap("settings", "e.toml").out == result.out


def test_a_robot_described_in_toml_has_its_quantities(stepgap: Command) -> None:
    from tests.robots.plug_in import CUSTOM_TOML

    Path("custom.toml").write_text(CUSTOM_TOML)
    result = stepgap("settings", "custom.toml")
    assert result.code == 0, result.err
    Path("again.toml").write_text(result.out)
    assert read_experiment(Path("again.toml")).robot == read_experiment(Path("custom.toml")).robot


def test_a_robot_described_in_toml_may_have_context(stepgap: Command) -> None:
    from tests.robots.plug_in import CUSTOM_TOML

    context = "".join(
        f"\n[[quantities.context]]\nname = '{name}'\n{rest}\n"
        for name, rest in (("ground", "unit = 'm'"), ("track", "unit = 'm'\nperiod = 8"))
    )
    Path("custom.toml").write_text(CUSTOM_TOML + context)
    space = read_experiment(Path("custom.toml")).robot.space
    assert space.context_names == ("ground", "track")
    assert space.periodic == ContextQuantity("track", "m", 8.0)
    Path("again.toml").write_text(stepgap("settings", "custom.toml").out)
    assert read_experiment(Path("again.toml")).robot.space == space
    Path("custom.toml").write_text(CUSTOM_TOML + context.replace("'track'", "'ground'"))
    assert "but it must have different names" in stepgap("settings", "custom.toml").err
