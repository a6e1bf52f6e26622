"""The residual of docs/extensions.md: its code runs, keeps the contract, and is found by its name."""

import json
import re
import subprocess
import sys
import tomllib
from importlib.metadata import distributions
from pathlib import Path

import numpy as np
import pytest
from uv import find_uv_bin

from stepgap.base.settings_file import InputError
from stepgap.experiment.loop import Plants, Setup, run_experiment
from stepgap.learning.entry_points import load_residual_model, residual_names
from stepgap.learning.regression import ResidualModel
from stepgap.learning.residual_fit import fit_residual, residual_from_dict
from stepgap.learning.settings import LearningSettings
from stepgap.plants.model_plant import ModelPlant
from stepgap.sweep.sweep_file import read_sweep
from tests.control.maps import LossyHopper
from tests.learning.residual_contract import ResidualContract, training_data
from tests.learning.test_residual import steps
from tests.report.pages import Page, check_alone
from tests.report.runs import REAL, TARGETS, report_of
from tests.robots.plug_in import section_of

PAGE = section_of("extensions.md", "A residual")
MODULE, *USES = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
PYPROJECT, SETTINGS, SWEEP = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
NAME = "bayesian_linear"


def install(folder: Path, package: str, code: str, **entries: str) -> None:
    """Installs a package with entry points of residuals into a folder, as pip does."""
    info = folder / f"{package}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    lines = [f"{name} = {value}" for name, value in entries.items()]
    (info / "entry_points.txt").write_text("\n".join(["[stepgap.residuals]", *lines, ""]))
    (folder / f"{package}.py").write_text(code, "utf-8")


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder in which Python finds installed packages."""
    (tmp_path / "packages").mkdir()
    monkeypatch.syspath_prepend(tmp_path / "packages")
    for name in ("own_residual", "broken"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path / "packages"


@pytest.fixture
def installed(packages: Path) -> None:
    """The page's package."""
    (entries,) = tomllib.loads(PYPROJECT)["project"]["entry-points"].values()
    install(packages, "own_residual", MODULE, **entries)


@pytest.mark.usefixtures("installed")
class TestOwnResidual(ResidualContract):
    @pytest.fixture
    def model(self) -> ResidualModel:
        return load_residual_model(NAME)


def test_the_package_of_the_page_is_installed_with_its_entry_point(tmp_path: Path) -> None:
    """By uv, without the network; a second module in the folder is left out."""
    folder, installed = tmp_path / "folder", tmp_path / "installed"
    folder.mkdir()
    for name, text in (("pyproject.toml", PYPROJECT), ("own_residual.py", MODULE), ("attempt.py", "")):
        (folder / name).write_text(text, "utf-8")
    options = ["--quiet", "--offline", "--no-cache", "--no-deps", "--no-build-isolation", "--python", sys.executable]
    command = [find_uv_bin(), "pip", "install", *options, "--target", str(installed), str(folder)]
    subprocess.run(command, check=True, capture_output=True)
    (found,) = (each for each in distributions(path=[str(installed)]) if each.name == "own-residual")
    assert [(each.name, each.value) for each in found.entry_points] == [(NAME, "own_residual:MODEL")]
    assert [path.name for path in installed.glob("*.py")] == ["own_residual.py"]


def test_it_is_short() -> None:
    assert len([line for line in MODULE.splitlines() if line.strip()]) < 40


@pytest.mark.usefixtures("installed")
def test_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile("\n".join(USES), "docs/extensions.md", "exec"), {"__name__": "page"})  # noqa: S102  (our own document)
    printed = re.fullmatch(rf"{NAME}: (.*) m/s without it, (.*) m/s with it\n", capsys.readouterr().out)
    assert printed
    assert float(printed[2]) < 0.2 * float(printed[1])


@pytest.mark.usefixtures("installed")
def test_it_is_the_posterior_of_a_gaussian_process_with_a_linear_kernel() -> None:
    """The function-space view of the same model, RW Eqs. 2.25 and 2.26, computed independently."""
    regression = load_residual_model(NAME).fit(data := training_data())
    noise, prior = (regression.to_dict()[name] for name in ("noise", "prior"))
    queries = training_data(5, seed=3).points

    def covariance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        return prior**2 * (1 + data.scaled(one) @ data.scaled(other).T)

    matrix, cross = covariance(data.points, data.points) + noise**2 * np.eye(30), covariance(queries, data.points)
    np.testing.assert_allclose(regression.mean(queries), cross @ np.linalg.solve(matrix, data.values), rtol=1e-8)
    variance = covariance(queries, queries) - cross @ np.linalg.solve(matrix, cross.T)
    np.testing.assert_allclose(regression.std(queries), np.sqrt(np.diag(variance)), rtol=1e-7)


@pytest.mark.usefixtures("installed")
def test_settings_accept_it() -> None:
    assert NAME in residual_names()
    assert "own_residual" not in sys.modules, "names are known without imports"
    LearningSettings(**tomllib.loads(SETTINGS)["learning"])
    assert "own_residual" not in sys.modules
    assert fit_residual("auto", steps()).kind != NAME, "it does not declare itself a candidate"


@pytest.mark.usefixtures("installed")
def test_a_sweep_compares_it(tmp_path: Path) -> None:
    (tmp_path / "sweep.toml").write_text(SWEEP, "utf-8")
    plan = read_sweep(tmp_path / "sweep.toml")
    assert len(plan) == 2 * 4
    cases = [plan.case(number)["files"]["experiment.toml"] for number in range(len(plan))]
    kinds = {tomllib.loads(case)["learning"]["residual"] for case in cases}
    assert kinds == {"none", "linear", "gp_on_linear", NAME}


@pytest.mark.usefixtures("installed")
def test_a_run_uses_it_and_the_report_includes_it(tmp_path: Path) -> None:
    def plant(rng: np.random.Generator) -> ModelPlant:
        return ModelPlant(REAL, np.array([0.1, 0.56]), np.array([0.005, 0.002]), rng)

    folder = tmp_path / "run"
    folder.mkdir()
    run_experiment(Setup(LossyHopper(), Plants(plant), TARGETS, LearningSettings(NAME, 1, tolerance=0.0)), folder)
    saved = json.loads((folder / "models" / "iteration_1.json").read_text())
    assert saved["kind"] == NAME
    page = Page(report_of(folder))
    check_alone(page)
    assert f"Deployment 1 began with the residual '{NAME}'" in page.text
    assert "a linear function, fitted to actual − nominal of 40 earlier steps" in page.text
    assert "leave-one-out RMSE" in page.text
    assert (folder / "figures" / "left_out.pdf").is_file()


def test_without_its_package_a_model_file_is_refused_in_one_line() -> None:
    saved = {**fit_residual("linear", steps(5)).to_dict(), "kind": NAME}
    with pytest.raises(InputError, match=rf"^residual '{NAME}': unknown; the residuals installed here are constant, "):
        residual_from_dict(saved)
    with pytest.raises(
        ValueError, match=r"^residual = 'linar', but it must be one of auto, .*; did you mean linear\?$"
    ):
        LearningSettings("linar")


@pytest.mark.parametrize("path", ["own_residual:MODEL", "os.path", "../own_residual", "stepgap.learning.zero"])
def test_a_file_cannot_import_code(packages: Path, path: str) -> None:
    (packages / "own_residual.py").write_text("raise SystemExit('imported')")
    with pytest.raises(InputError, match="unknown"):
        residual_from_dict({"kind": path, "regressions": [{}], "command_size": 1, "forgetting_time": None})


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ("import no_such_package", "residual 'own' needs no_such_package: pip install 'no_such_package'"),
        ("MODEL = 3", "residual 'own': broken:MODEL of broken must be a ResidualModel"),
        (
            "from stepgap.learning.zero import NONE as MODEL",
            "residual 'own': its model has the name 'none'; both names",
        ),
    ],
)
def test_a_model_that_cannot_be_used_gives_the_reason(packages: Path, code: str, expected: str) -> None:
    install(packages, "broken", code, own="broken:MODEL")
    with pytest.raises(InputError, match=re.escape(expected)):
        fit_residual("own", steps())
    LearningSettings("linear")  # others are not affected
