"""The verbs as Python functions do what the commands do."""

from pathlib import Path

import pytest

from stepgap import verbs
from stepgap.base.errors import InputError
from stepgap.cli.verbs import verb_names
from tests.cli.command_line import Command

pytestmark = pytest.mark.usefixtures("package")


def test_a_function_prints_what_its_command_prints(stepgap: Command, capfd: pytest.CaptureFixture[str]) -> None:
    by_command = stepgap("settings", "--robot", "ball", "--gap.drag", "0.3")
    assert verbs.settings(robot="ball", gap={"drag": 0.3})
    assert capfd.readouterr().out == by_command.out
    assert "drag = 0.3" in by_command.out


def test_exit_code_1_is_false(stepgap: Command) -> None:
    Path("far.csv").write_text("height\n" + "1e6\n" * 6)
    assert stepgap("check", "ball", "--reference", "far.csv").code == 1
    assert not verbs.check("ball", reference="far.csv")


def test_wrong_input_is_an_error() -> None:
    with pytest.raises(InputError, match=r"runs/none"):
        verbs.report("runs/none")
    with pytest.raises(InputError, match="Unknown option"):
        verbs.report("runs/none", colour="red")


def test_every_verb_is_a_function_with_the_help_of_the_command() -> None:
    assert dir(verbs) == sorted(verb_names())
    assert "limit cycle" in (verbs.gait.__doc__ or "")
    with pytest.raises(AttributeError, match=r"no 'walk'; its verbs are .*check"):
        verbs.walk()
