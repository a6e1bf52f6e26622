"""The code of docs/tutorial.md, one block after the other, with three steps to each speed instead of six."""

import re
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


def test_the_notebook_is_that_of_the_page() -> None:
    notebook = ROOT / "examples" / "notebooks" / "tutorial.ipynb"
    assert notebook.read_text("utf-8") == notebook_of(PAGE)
