"""`stepgap prior` and runs that begin with a prior: from a sweep over random twins to hops of another twin."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from stepgap.cli.app import main
from stepgap.records.prior_file import read_prior
from stepgap.robots.hopper.robot import Hopper
from tests.cli.command_line import Command, refused
from tests.quick_runs import compute_in_a_thread, leave_out_repeats, leave_out_report, leave_out_sweep_report

pytestmark = pytest.mark.usefixtures("no_repeats", "no_report")

SWEEP = """
base = "base.toml"
twins = 6
keep = "steps"
"""
BASE = """
reference = "targets.csv"
[learning]
iterations = 0
residual = "none"
"""


@pytest.fixture(scope="module")
def family(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sweep `twins` over six twins that make 18 steps each, and the prior found from them."""
    folder = tmp_path_factory.mktemp("family")
    targets = np.random.default_rng(0).uniform([0.0, 0.54], [0.4, 0.62], (18, 2))
    rows = "".join(f"{speed:.3f},{height:.3f}\n" for speed, height in targets)
    for name, text in {"targets.csv": f"speed,height\n{rows}", "base.toml": BASE, "sweep.toml": SWEEP}.items():
        (folder / name).write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        for leave_out in (leave_out_repeats, leave_out_report, leave_out_sweep_report, compute_in_a_thread):
            leave_out(patch)
        main(["sweep", str(folder / "sweep.toml"), "--out", str(folder / "twins"), "--quiet"])
        main(["prior", str(folder / "twins"), "--out", str(folder / "prior.json"), "--quiet"])
    return folder


def test_the_file_says_what_it_was_found_from(family: Path) -> None:
    saved = json.loads((family / "prior.json").read_text())
    assert (saved["robot"], saved["nominal"]) == ("hopper", "equations")
    assert (saved["provenance"]["robots"], saved["provenance"]["steps"]) == (6, 108)
    assert saved["monomials"][:3] == ["1", "speed", "height"]
    assert saved["monomials"][-1] == "fy fy"
    assert [each["name"] for each in saved["coordinates"]] == ["speed", "height"]


def test_the_file_and_what_is_read_from_it_are_the_same(family: Path) -> None:
    found = read_prior(family / "prior.json", Hopper().space)
    assert found.text() == (family / "prior.json").read_text()


def test_a_run_begins_with_it_and_can_be_repeated(family: Path, stepgap: Command) -> None:
    arguments = ["--reference", family / "targets.csv", "--iterations", 0, "--online", "--seed", 3, "--quiet", "--out"]
    assert stepgap("run", *arguments, "first", "--prior", family / "prior.json").code == 0
    beliefs = json.loads(Path("first/models/iteration_0.json").read_text())["beliefs"]["beliefs"]
    assert "family" in [each["kind"] for each in beliefs]
    assert Path("first/prior.json").read_bytes() == (family / "prior.json").read_bytes()
    assert 'prior = "prior.json"\n' in Path("first/experiment.toml").read_text()

    assert stepgap("run", "first/experiment.toml", "--out", "again", "--quiet").code == 0
    names = ("experiment.toml", "steps.csv", "prior.json", "models/iteration_0.json")
    assert all(Path("again", name).read_bytes() == Path("first", name).read_bytes() for name in names)
    lines = Path("again/steps.csv").read_text().splitlines(keepends=True)
    Path("again/steps.csv").write_text("".join(lines[:6]))
    Path("again/summary.json").unlink()
    assert stepgap("run", "--resume", "--out", "again", "--quiet").code == 0
    assert Path("again/steps.csv").read_bytes() == Path("first/steps.csv").read_bytes()


def test_several_priors_compete_and_are_copied(family: Path, stepgap: Command) -> None:
    found = json.loads((family / "prior.json").read_text())
    for coordinate in found["coordinates"]:
        coordinate["mean"] = [5.0 + each for each in coordinate["mean"]]
    Path("both").mkdir()
    Path("both/a_wrong.json").write_text(json.dumps(found))
    Path("both/right.json").write_bytes((family / "prior.json").read_bytes())
    arguments = ["--reference", family / "targets.csv", "--iterations", 1, "--seed", 3, "--quiet", "--out"]
    assert stepgap("run", *arguments, "first", "--prior", "both").code == 0
    assert stepgap("run", *arguments, "one", "--prior", "both/right.json").code == 0
    first, one = (json.loads(Path(run, "models/iteration_1.json").read_text()) for run in ("first", "one"))
    for both, alone in zip(first["regressions"], one["regressions"], strict=True):
        np.testing.assert_allclose(both["weights"], alone["weights"], atol=0.01)
    assert sorted(each.name for each in Path("first/priors").iterdir()) == ["a_wrong.json", "right.json"]
    assert 'prior = "priors"\n' in Path("first/experiment.toml").read_text()

    lines = Path("first/steps.csv").read_text().splitlines(keepends=True)
    Path("first/steps.csv").write_text("".join(lines[:6]) + "damaged")
    assert stepgap("recover", "first", "--out", "recovered").code == 0
    assert sorted(each.name for each in Path("recovered/priors").iterdir()) == ["a_wrong.json", "right.json"]
    Path("empty").mkdir()
    refused(stepgap("run", *arguments, "third", "--prior", "empty"), "empty", "no file of `stepgap prior`")


def test_runs_begin_with_that_of_the_robot(family: Path, stepgap: Command) -> None:
    arguments = ["--reference", family / "targets.csv", "--iterations", 0, "--quiet", "--out"]
    for name, more in {"with": ["--online"], "without": ["--online", "--prior", "none"], "default": []}.items():
        assert stepgap("run", *arguments, name, *more).code == 0
        assert Path(name, "models/iteration_0.json").exists() == (name != "default")
    first = {name: Path(name, "steps.csv").read_text().splitlines()[2] for name in ("with", "without", "default")}
    assert len({*first.values()}) == 3  # the first hop, too, is learned from online


@pytest.mark.parametrize("setting", [("residual", "linear"), ("residual", "auto"), ("drift", "false")])
def test_a_prior_that_nothing_would_begin_with_is_refused(
    family: Path, stepgap: Command, setting: tuple[str, str]
) -> None:
    name, value = setting
    arguments = ["--prior", family / "prior.json", f"--learning.{name}", value, "--out", "run"]
    refused(stepgap("run", *arguments), "only beliefs begin with a prior", "learning.residual = 'posterior'")
    assert not Path("run").exists()


def test_redeployments_begin_with_that_of_the_robot(stepgap: Command) -> None:
    Path("short.csv").write_text("speed,height\n0.1,0.56\n0.2,0.58\n")
    models = []
    for name, more in {"with": [], "without": ["--prior", "none"]}.items():
        arguments = ["--reference", "short.csv", "--iterations", 1, "--quiet", "--out", name, *more]
        assert stepgap("run", *arguments).code == 0
        models.append(json.loads(Path(name, "models/iteration_1.json").read_text()))
        assert not Path(name, "models/iteration_0.json").exists()
    families = [[each["kind"] for each in model["beliefs"]["beliefs"]].count("family") for model in models]
    assert families[0] > 0 == families[1]


def test_cases_of_a_sweep_may_have_several_priors(family: Path, stepgap: Command) -> None:
    Path("both").mkdir()
    for name in ("a.json", "b.json"):
        Path("both", name).write_bytes((family / "prior.json").read_bytes())
    base = f'reference = "{family / "targets.csv"}"\nprior = "both"\n[learning]\niterations = 0\nonline = true\n'
    Path("base.toml").write_text(base)
    Path("sweep.toml").write_text('base = "base.toml"\nseeds = [1]\n')
    found = stepgap("sweep", "sweep.toml", "--out", "swept", "--quiet")
    assert found.code == 0, found.err
    assert len(Path("swept/results.csv").read_text().splitlines()) > 1


def test_a_run_that_is_named_twice_counts_once(family: Path, stepgap: Command) -> None:
    run = min((family / "twins" / "runs").iterdir())
    refused(stepgap("prior", *[run] * 6, f"{run}/", "--out", "one.json"), "1 robots with enough steps")


def test_a_run_whose_steps_were_changed_is_refused(family: Path, stepgap: Command) -> None:
    shutil.copytree(family / "twins" / "runs", "changed")
    steps = min(Path("changed").iterdir()) / "steps.csv"
    heads, *rows = (line.split(",") for line in steps.read_text().splitlines())
    rows[3][heads.index("next_speed")] = "0.5"
    steps.write_text("\n".join(",".join(row) for row in [heads, *rows]) + "\n")
    refused(stepgap("prior", "changed", "--out", "changed.json"), "steps.csv", "changed after it was written")


def test_too_few_robots(family: Path, stepgap: Command) -> None:
    runs = sorted((family / "twins" / "runs").iterdir())[:3]
    refused(stepgap("prior", *runs, "--out", "p.json"), "3 robots", "at least 5")
    refused(stepgap("prior", "--out", "p.json"), "RUNS", "sweep over random twins")
    refused(stepgap("prior", "nowhere", "--out", "p.json"), "nowhere")


def test_nothing_is_overwritten(family: Path, stepgap: Command) -> None:
    Path("p.json").write_text("mine")
    refused(stepgap("prior", family / "twins", "--out", "p.json"), "p.json")
    assert Path("p.json").read_text() == "mine"


def test_a_prior_of_another_robot_or_map_is_refused(family: Path, stepgap: Command) -> None:
    prior = ["--prior", family / "prior.json", "--out", "x"]
    refused(stepgap("run", "--robot", "quadruped", *prior), "prior.json", "it is for speed, height, fx, fy", "fz")
    linear = ["--nominal.linear", "true"]
    refused(stepgap("run", *linear, *prior), "prior.json", "a linear map of nominal.kind = 'equations'")
    refused(stepgap("run", "--method", "affine", *prior), "prior.json", "only beliefs begin with a prior")
    refused(stepgap("run", "--prior", "nowhere.json", "--out", "x"), "nowhere.json", "robot, none or a file")


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ('"stepgap prior 1"', '"stepgap prior 9"', ["format must be 'stepgap prior 1'"]),
        ('"noise_std": 0', '"noise_std": -0', ["noise_std must lie between"]),
        ('"scale": ', '"scale": -', ["scale must lie between"]),
        ('"mean": [', '"mean": [1.0,', ["15 numbers"]),
        ('"covariance": [', '"covariance": [[NaN],', ["NaN"]),
        ('"robot": "hopper"', '"robot": "monopod"', ["it is of robot 'monopod'", "'hopper'"]),
        ("{", "", ["not JSON"]),
    ],
)
def test_a_damaged_file_is_refused(family: Path, old: str, new: str, parts: list[str], stepgap: Command) -> None:
    text = (family / "prior.json").read_text()
    assert old in text
    Path("damaged.json").write_text(text.replace(old, new, 1))
    refused(
        stepgap("run", "--prior", "damaged.json", "--out", "x"), "damaged.json", *(p for p in parts if p != "not JSON")
    )
