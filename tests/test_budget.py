"""No folder of the package has more lines of code than `pyproject.toml` allows; raising one needs a reason there."""

import ast
import io
import tokenize
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "stepgap"
BUDGET = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["stepgap"]["budget"]
NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}


def lines_of(node: ast.stmt) -> set[int]:
    return set(range(node.lineno, (node.end_lineno or node.lineno) + 1))


def is_text(node: ast.stmt) -> bool:
    """Whether a statement is a string alone: documentation."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def code_lines(text: str) -> int:
    """Number of lines of code without documentation, comments, blank lines and imports."""
    written: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            written |= set(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import | ast.ImportFrom) or (isinstance(node, ast.stmt) and is_text(node)):
            written -= lines_of(node)
    return len(written)


def test_only_code_counts() -> None:
    text = (
        '"""A module."""\n\nimport os\n\nA = 1\n"""Its meaning."""\n\n\ndef f(\n    a,\n):\n    # why\n    return 1\n'
    )
    assert code_lines(text) == 1 + 3 + 1


@pytest.mark.parametrize("folder", sorted(path.name for path in PACKAGE.iterdir() if any(path.glob("**/*.py"))))
def test_a_folder_keeps_its_budget(folder: str) -> None:
    lines = sum(code_lines(path.read_text("utf-8")) for path in (PACKAGE / folder).rglob("*.py"))
    assert lines <= BUDGET[folder], f"{folder}: {lines} lines of code"


def test_each_budget_is_that_of_a_folder() -> None:
    assert all((PACKAGE / folder).is_dir() for folder in BUDGET)
