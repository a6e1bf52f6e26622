"""The documents' code runs, and the documents speak of what is there."""

import re
import runpy
import shlex
from pathlib import Path

import numpy as np
import pytest

from stepgap.base.settings_file import read_toml
from stepgap.cli.app import split_overrides, split_program
from stepgap.cli.verbs import GONE, command_line
from stepgap.experiment.settings import read_experiment
from stepgap.hardware.ethercat.emulator.network import NoNetwork
from stepgap.logs.columns import read_columns
from stepgap.sweep.sweep import Sweep
from stepgap.sweep.sweep_file import read_sweep
from tests.cli.command_line import Command

ROOT = Path(__file__).parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
RUN_ELSEWHERE = {
    "own_rig.md": "rigs/test_own_rig.py",
    "extensions.md": "robots/plug_in.py",
    "data.md": "test_docs_data.py",
    "model_file.md": "export/controller/test_model_file.py",
    "tutorial.md": "test_docs_tutorial.py",
    "notebook_robots.md": "test_docs_tutorial.py",
    "notebook_policy.md": "test_docs_tutorial.py",
    "steps.md": "test_docs_steps.py",
}
"""Pages whose blocks need more around them."""

WITH_OUTPUT = ("index.md",)
"""Pages that show below their blocks what these print, with rounded numbers."""

EXAMPLES_ELSEWHERE = {"own_robot.py": "test_own_robot.py"}
"""Examples that a test of their own runs as programs."""

TEXTS = {page: page.read_text("utf-8") for page in PAGES}
SCRIPTS = {
    page: "\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL))
    for page, text in TEXTS.items()
    if "```python" in text and page.name not in RUN_ELSEWHERE
}
COMMANDS = sorted({
    found.strip().removeprefix("./go ")
    for text in TEXTS.values()
    for found in re.findall(r"^ *(?:\./go )?stepgap .*", text.replace("\\\n", " "), re.MULTILINE)
})  # fmt: skip
SETTINGS = [
    pytest.param(page, block, id=f"{page.name}-{number}")
    for page, text in TEXTS.items()
    for number, block in enumerate(re.findall(r"```toml\n(.*?)```", text, re.DOTALL))
]


def read_sweep_with_base(file: Path) -> Sweep:
    """The sweep of a file with the default experiment beside it."""
    (file.parent / "experiment.toml").write_text("# the defaults\n")
    return read_sweep(file)


READERS = {
    "sweep.md": read_sweep_with_base,
    "quickstart.md": read_experiment,
    "fit.md": lambda file: read_columns(file, {}),
}
MENTIONED = sorted({found for text in TEXTS.values() for found in re.findall(r"`(?:\./go )?(stepgap [^`]+)`", text)})
EXAMPLE_IN_TABLE = re.compile(r"\| `([^`|]+)` \|$", re.MULTILINE)

KNOWN_HELP: dict[tuple[str, ...], str] = {}
"""Help of the verbs that were asked for; texts mention the same few again and again."""


def name(page):
    return page.name


@pytest.mark.parametrize("page", SCRIPTS, ids=name)
def test_pages_run(page, tmp_path, monkeypatch, capsys):
    """Blocks of a page continue each other, examples in the last column of a table after them."""
    monkeypatch.chdir(tmp_path)
    examples = EXAMPLE_IN_TABLE.findall(TEXTS[page]) if page.name == "from_matlab.md" else []
    script = tmp_path / f"{page.stem}.py"
    script.write_text("\n".join([SCRIPTS[page], *examples]), "utf-8")
    try:
        runpy.run_path(str(script), run_name="__main__")
    except NoNetwork as reason:
        pytest.skip(str(reason))
    if page.name in WITH_OUTPUT:
        check_output(capsys.readouterr().out, "".join(re.findall(r"```text\n(.*?)```", TEXTS[page], re.DOTALL)))


def check_output(printed, shown):
    """Numbers agree within 2e-4 or 0.2 %, the words exactly."""
    number = r"-?\d\.\d*(?:e-\d+)?"
    assert re.sub(number, "", printed).split() == re.sub(number, "", shown).split()
    values, rounded = ([float(found) for found in re.findall(number, text)] for text in (printed, shown))
    assert values == pytest.approx(rounded, rel=2e-3, abs=2e-4)


@pytest.mark.parametrize("page", RUN_ELSEWHERE)
def test_the_other_pages_run_elsewhere(page):
    if (ROOT / "docs" / page).exists():
        assert f'"{page}"' in (ROOT / "tests" / RUN_ELSEWHERE[page]).read_text("utf-8")


@pytest.mark.parametrize("example", EXAMPLES_ELSEWHERE)
def test_the_other_examples_run_elsewhere(example):
    assert (ROOT / "examples" / example).exists()
    assert f'"{example}"' in (ROOT / "tests" / EXAMPLES_ELSEWHERE[example]).read_text("utf-8")


def test_the_examples_for_those_from_matlab_are_many():
    assert len(EXAMPLE_IN_TABLE.findall(TEXTS[ROOT / "docs" / "from_matlab.md"])) > 30


@pytest.mark.parametrize(("page", "block"), SETTINGS)
def test_settings_are_read(page, block, tmp_path):
    file = tmp_path / "settings.toml"
    file.write_text(block, "utf-8")
    assert READERS.get(page.name, lambda file: read_toml(file, "settings"))(file)


@pytest.mark.usefixtures("package")
@pytest.mark.parametrize("command", COMMANDS)
def test_commands_are_understood(command):
    """Verb, options and settings of a whole command line; the files that it names need not be there."""
    check_command(shlex.split(command, comments=True))


def check_command(words):
    if words[:2] == ["sh", "-c"]:
        for part in words[2].split("&&"):
            check_command(shlex.split(part))
        return
    assert words[0] == "stepgap"
    arguments, program = split_program(words[1:])
    rest, overrides = split_overrides(arguments)
    command_line().parse_args(rest, exit_on_error=False, print_error=False)
    read_experiment(None, overrides)
    if program[:1] == ["stepgap"]:
        check_command(program)


@pytest.mark.parametrize("words", MENTIONED)
def test_verbs_and_options_exist(words, stepgap: Command):
    """A text may mention a command without the rest of its command line, or say what is gone."""
    arguments = words.split()[1:]
    verbs = []
    while arguments and re.fullmatch("[a-z-]+", arguments[0]) and help_of(stepgap, *verbs, arguments[0]):
        verbs.append(arguments.pop(0))
    text = help_of(stepgap, *verbs)
    assert text, words
    for option in re.findall(r"(?<!\S)--[a-z-]+(?![a-z.-])", " ".join(arguments)):
        assert re.search(rf"{option}\b", text) or " ".join([*verbs, option]) in GONE, option


def help_of(stepgap: Command, *verbs):
    if verbs not in KNOWN_HELP:
        result = stepgap(*verbs, "--help")
        KNOWN_HELP[verbs] = result.out if result.code == 0 else ""
    return KNOWN_HELP[verbs]


@pytest.mark.parametrize("example", [each for each in EXAMPLES if each.name not in EXAMPLES_ELSEWHERE], ids=name)
def test_examples_run(example, capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", [str(example)])
    runpy.run_path(str(example), run_name="__main__")
    assert capsys.readouterr().out


def test_learning_helps_in_the_example(capsys):
    runpy.run_path(str(ROOT / "examples" / "learn_from_hops.py"), run_name="__main__")
    without, with_gp = (re.findall(r"\d\.\d+", line) for line in capsys.readouterr().out.splitlines())
    assert float(with_gp[0]) < 0.5 * float(without[0])
    assert float(with_gp[1]) < 0.5 * float(without[1])


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_somewhere(page):
    """In the repository; `mkdocs build --strict` asks the same of the site, anchors too."""
    for target in re.findall(r"\]\(([^)#: ]+)[) #]", TEXTS[page]):
        assert (page.parent / target).exists(), target


def test_files_named_in_the_architecture_exist():
    for name in re.findall(r"`([a-z_/]+(?:/|\.py))`", TEXTS[ROOT / "ARCHITECTURE.md"]):
        assert (ROOT / "src" / "stepgap" / name).exists(), name


def test_the_papers_hardware_run_has_the_errors_that_its_page_states():
    run = np.genfromtxt(ROOT / "examples" / "krause2023_fig4.csv", delimiter=",", names=True)
    assert len(run) == 227
    for name, state, target in (("speed", "v_nogp", "v_ref"), ("height", "y_nogp", "y_ref")):
        stated = re.findall(rf"^\| {name}, 10 blocks \| (\S+)", TEXTS[ROOT / "docs" / "fit.md"], re.MULTILINE)
        errors = (run[state] - run[target])[1:]  # the state before the first step is not known
        assert float(stated[0]) == pytest.approx(np.sqrt(np.mean(errors**2)), abs=6e-5)
