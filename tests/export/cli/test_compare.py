"""The verb `compare`: runs and model files on one page."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from stepgap.control.settings import ControlSettings
from stepgap.export.controller.model_document import model_text
from stepgap.export.controller.portable_controller import PortableController
from stepgap.study.individuals import Individual
from tests.cli.command_line import Command, CommandResult, refused
from tests.report.runs import make_run
from tests.study.test_individuals import robot


def write_model(individual: Individual, path: Path) -> None:
    """Writes the model file of a robot."""
    none = np.empty((0, len(individual.nominal.space.names)))
    passport = {"robot": "walker", "name": individual.name, "settings_sha256": 64 * "a"}
    controller = PortableController(
        individual.nominal, individual.residual, None, none, ControlSettings(), passport=passport
    )
    path.write_text(model_text(controller), "utf-8")


def test_model_files_are_compared_by_the_names_of_their_passports(
    tmp_path: Path, stepgap: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    paths = [f"{number}.json" for number in range(6)]
    for number, path in enumerate(paths):
        write_model(robot(number, slow=0.3 * (number == 2)), Path(path))
    result = stepgap("compare", *paths, "--out", "page.html")
    assert (result.code, result.err) == (0, "")
    sentence, page = result.out.splitlines()
    assert sentence.startswith("unit 2: its vx is 0.29 m/s lower than that of the others at cx 0.59 m/s")
    assert page == "page.html"
    text = Path("page.html").read_text("utf-8")
    assert "StepGap comparison of 6 robots" in text
    assert "<td>walker</td>" in text
    refused(stepgap("compare", *paths, "--out", "page.html"), "page.html: exists already; choose another --out")
    refused(stepgap("compare", paths[0]), "one run or model file cannot be compared; give at least two")
    broken = json.loads(Path(paths[1]).read_text("utf-8"))
    Path("broken.json").write_text(json.dumps({**broken, "schema": 3}), "utf-8")
    refused(stepgap("compare", paths[0], "broken.json"), "broken.json: not a model file (schema is 3, that of a former")
    for wrong in ([], [["name", "x"]], "text", None, {"name": 5}, {"name": "\x1b[31m"}, {"name": "x" * 61}):
        Path("broken.json").write_text(json.dumps({**broken, "passport": wrong}), "utf-8")
        refused(stepgap("compare", paths[0], "broken.json"), "broken.json: not a model file (passport")
    odd = {"name": "<script>a</script>", "<b>": "<img src=x>", "errors": 5}
    Path("broken.json").write_text(json.dumps({**broken, "passport": odd}), "utf-8")
    assert stepgap("compare", *paths, "broken.json", "--out", "odd.html").code == 0
    assert not re.search("<script>a|<b>|<img src=x", Path("odd.html").read_text("utf-8"))


def test_runs_are_compared(tmp_path: Path, stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    make_run(tmp_path / "a", 1)
    shutil.copytree("a", "b")
    Path("comparison.html").write_text("precious")
    result = stepgap("compare", "a", "b")
    assert (result.code, result.err) == (0, "")
    reason, page = result.out.splitlines()
    assert reason.startswith("what was learned is not compared: a: ")
    assert Path(page).samefile("comparison_2.html")
    assert "StepGap comparison of 2 runs" in Path("comparison_2.html").read_text(encoding="utf-8")
    assert stepgap("compare", "a", "b", "--out", "page.html") == CommandResult(0, f"{reason}\npage.html\n", "")
    assert Path("comparison.html").read_text() == "precious"
    refused(stepgap("compare", "a", "b", "--out", "none/page.html"), "none/page.html: cannot be written")
    refused(stepgap("compare", "a", "a"), "a run is given twice")
    refused(stepgap("compare", "a", "none"), "none/steps.csv: no such file", "must be the folder of a run")
