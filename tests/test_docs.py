"""The documents' code runs, and the documents speak of what is there."""

import re
import runpy
from pathlib import Path

import pytest

import stepgap

ROOT = Path(__file__).parent.parent
DOCUMENTS = sorted(ROOT.glob("*.md"))
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
PAGES = [ROOT / "docs" / name for name in ("gym.md", "own_map.md")]
"""Pages whose blocks go on from each other."""


PYTHON_BLOCKS = [
    pytest.param(block, id=f"{document.name}-{number}")
    for document in DOCUMENTS
    for number, block in enumerate(re.findall(r"```python\n(.*?)```", document.read_text("utf-8"), re.DOTALL))
]


@pytest.mark.parametrize("block", PYTHON_BLOCKS)
def test_python_blocks_run(block):
    exec(compile(block, "document", "exec"), {})  # noqa: S102  (our own documents)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_pages_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "page"}
    for block in re.findall(r"```python\n(.*?)```", page.read_text("utf-8"), re.DOTALL):
        exec(compile(block, page.name, "exec"), names)  # noqa: S102  (our own documents)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.name)
def test_examples_run(example, capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", [str(example)])
    runpy.run_path(str(example), run_name="__main__")
    assert capsys.readouterr().out


def test_learning_helps_in_the_example(capsys):
    runpy.run_path(str(ROOT / "examples" / "learn_from_hops.py"), run_name="__main__")
    without, with_gp = (re.findall(r"\d\.\d+", line) for line in capsys.readouterr().out.splitlines())
    assert float(with_gp[0]) < 0.5 * float(without[0])
    assert float(with_gp[1]) < 0.5 * float(without[1])


@pytest.mark.parametrize("document", [*DOCUMENTS, *PAGES], ids=lambda path: path.name)
def test_links_lead_somewhere(document):
    for target in re.findall(r"\]\(([^)#]+)\)", document.read_text("utf-8")):
        if "://" not in target:
            assert (document.parent / target).exists(), target


def test_files_named_in_the_architecture_exist():
    text = (ROOT / "ARCHITECTURE.md").read_text("utf-8")
    for name in re.findall(r"`([a-z_/]+(?:/|\.py))`", text):
        assert (ROOT / "src" / "stepgap" / name).exists(), name


def test_every_public_name_can_be_imported():
    for name in stepgap.__all__:
        assert getattr(stepgap, name).__name__ == name
    with pytest.raises(AttributeError, match="public names are"):
        stepgap.Stepcontroller  # noqa: B018
