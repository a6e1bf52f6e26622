"""The code of the pages that are notebooks, one block after the other, with fewer steps."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

from docs.notebook import notebook_of

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "tutorial.md").read_text("utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.usefixtures("no_repeats")
def test_the_tutorial_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in BLOCKS:
        exec(compile(block.replace("0.2], 6)", "0.2], 3)"), "tutorial.md", "exec"), names)  # noqa: S102  (our own page)
    assert len(names["run"].steps) == 30
    first, last = names["run"].deployments
    assert (last.rmse < first.rmse).all()
    assert names["other"].settings.learning.residual == "linear"
    for name in ("tracking.png", "prediction_errors.png", "learned.png", "comparison.html"):
        assert Path(name).stat().st_size
    assert mpl.rcParams["font.size"] == mpl.rcParamsDefault["font.size"]


@pytest.mark.usefixtures("no_repeats")
def test_own_robots_are_learned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = run_page("notebook_robots.md", {"1.1], 8)": "1.1], 4)"}, tmp_path, monkeypatch)
    for name in ("slip", "mjcf"):
        first, last = names[name].deployments
        assert (last.rmse < 0.5 * first.rmse).all(), name


@pytest.mark.usefixtures("no_repeats")
def test_a_crooked_walk_is_straightened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = run_page("notebook_policy.md", {"0.5], 6)": "0.5], 3)"}, tmp_path, monkeypatch)
    first, last = names["run"].deployments
    assert last.rmse[0] < 0.8 * first.rmse[0]
    assert abs(names["y"][-1]) < 0.3, "the last way, that of the learned map"


def run_page(page: str, shorter: Mapping[str, str], folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Runs the Python blocks of a page in a folder; returns their names."""
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {"__name__": "page"}
    code = "".join(re.findall(r"```python\n(.*?)```", page_text(page), re.DOTALL))
    for before, after in shorter.items():
        assert before in code
        code = code.replace(before, after)
    exec(compile(code, page, "exec"), names)  # noqa: S102  (our own page)
    return names


def page_text(page: str) -> str:
    return (ROOT / "docs" / page).read_text("utf-8")


@pytest.mark.parametrize("page", ["tutorial.md", "notebook_robots.md", "notebook_policy.md"])
def test_each_notebook_is_that_of_its_page(page: str) -> None:
    notebook = ROOT / "examples" / "notebooks" / page.replace(".md", ".ipynb")
    assert notebook.read_text("utf-8") == notebook_of(page_text(page))
