"""The verb of docs/extensions.md: it is found by its name, and a verb that cannot be loaded disturbs no other one."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.command_line import Command, refused
from tests.robots.plug_in import install_extension, install_package, module_in, section_of

PYPROJECT_LINES, MOST_LINES = 14, 60
Install = Callable[[str], None]


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder with the page's package, which Python finds."""
    folder = tmp_path / "packages"
    folder.mkdir()
    install_extension(folder, "A verb")
    monkeypatch.syspath_prepend(folder)
    for name in ("authority_verb", "broken"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return folder


@pytest.fixture
def break_verb(installed: Path) -> Install:
    """Installs another package with the verb `broken`."""

    def install(code: str) -> None:
        points = {"stepgap.verbs": {"broken": "broken:verb"}}
        install_package(installed, {"name": "broken", "version": "1.0", "entry-points": points}, broken=code)

    return install


def test_it_is_short() -> None:
    assert len(module_in(section_of("extensions.md", "A verb")).splitlines()) + PYPROJECT_LINES < MOST_LINES


@pytest.mark.usefixtures("installed")
def test_it_is_in_the_help_after_ours_and_has_one_of_its_own(stepgap: Command) -> None:
    whole, own = stepgap("--help"), stepgap("authority", "--help")
    assert (whole.code, whole.err, own.code) == (0, "", 0)
    assert (
        whole.out.index("│ run ")
        < whole.out.index("│ rig ")
        < whole.out.index("authority")
        < whole.out.index("Print how far each command")
    )
    assert "--share" in own.out
    assert "--robot NAME chooses the robot" in own.out, "it takes settings"


@pytest.mark.usefixtures("installed")
def test_it_takes_options_and_settings(stepgap: Command) -> None:
    whole, half = stepgap("authority"), stepgap("authority", "--share", "0.5", "--gains.stiffness", "2500")
    assert (whole.code, whole.err) == (0, "")
    assert whole.out.startswith("speed [m/s]: fx +0.")
    numbers = [
        [float(word) for word in text.replace(",", "").split() if word[0] in "+-"] for text in (whole.out, half.out)
    ]
    assert numbers[0] == pytest.approx([2 * number for number in numbers[1]], rel=0.01)
    refused(stepgap("authority", "--gains.stifness", "1"), "gains.stifness", "did you mean")


@pytest.mark.usefixtures("installed")
def test_it_is_completed_with_its_options_and_settings(stepgap: Command) -> None:
    script = stepgap("completion", "bash").out
    assert "authority" in script
    assert "--share" in script
    assert '"authority --"*' in script, "it takes settings"


BROKEN = {
    "import no_such_package": "verb 'broken' needs no_such_package: pip install 'no_such_package'",
    "verb = 3": "verb 'broken': broken:verb of broken must be a function or a Cyclopts App",
    "1 / 0": "verb 'broken': ZeroDivisionError: division by zero",
    "verb =": "verb 'broken': SyntaxError: invalid syntax (broken.py, line 1)",
}


@pytest.mark.parametrize("code", BROKEN)
def test_a_verb_that_cannot_be_loaded_is_left_out_with_a_warning(
    stepgap: Command, break_verb: Install, code: str
) -> None:
    break_verb(code)
    result = stepgap("--help")
    assert (result.code, result.err) == (0, f"stepgap: {BROKEN[code]}\n")
    assert "authority" in result.out
    assert "broken" not in result.out
    quiet = stepgap("authority")
    assert (quiet.code, quiet.err) == (0, ""), "another verb is not loaded"
    refused(stepgap("broken"), BROKEN[code].partition(": ")[2])


@pytest.mark.usefixtures("installed")
def test_two_verbs_with_one_name_are_left_out(stepgap: Command, installed: Path) -> None:
    points = {"stepgap.verbs": {"gait": "broken:verb"}}
    install_package(installed, {"name": "broken", "version": "1.0", "entry-points": points}, broken="")
    for result in (stepgap("--help"), stepgap("gait")):
        assert "verb 'gait': offered by broken and by stepgap; uninstall one of them" in result.err
    assert stepgap("settings").code == 0


def test_the_verb_runs_in_a_process_of_its_own(installed: Path) -> None:
    code = f"import sys; sys.path.insert(0, {str(installed)!r}); from stepgap.cli.start import start; start()"
    command = [sys.executable, "-c", code, "authority", "--help"]
    assert "--share" in subprocess.run(command, capture_output=True, text=True, check=True).stdout
