"""The import layers of pyproject.toml hold, and learning reads and writes no file."""

import ast
import re
from pathlib import Path

import importlinter.api  # noqa: F401  (configures import-linter on import)
from importlinter.application import use_cases

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"


def test_one_module_reads_toml() -> None:
    source = PYPROJECT.parent / "src" / "stepgap"
    readers = [path for path in source.rglob("*.py") if "tomllib" in path.read_text("utf-8")]
    assert readers == [source / "base" / "settings_file.py"], "others must use its read_toml or parse_toml"


def test_imports_point_down() -> None:
    kept = use_cases.lint_imports(config_filename=str(PYPROJECT), cache_dir=None, no_logo=True)
    assert kept, "an import points up or across; `./go lint-imports` shows it"


def test_the_package_imports_nothing_from_the_checkout() -> None:
    """Neither by a statement nor by a changed search path."""
    for path in (PYPROJECT.parent / "src").rglob("*.py"):
        text = path.read_text("utf-8")
        assert not re.search(r"\bsys\.path(\.|\[| *\+?=)", text), path
        if not re.search(r"\b(benchmarks|tests|examples)\b", text):
            continue
        for node in ast.walk(ast.parse(text)):
            modules = [node.module] if isinstance(node, ast.ImportFrom) else []
            modules += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert not {"benchmarks", "tests", "examples"} & {str(module).partition(".")[0] for module in modules}, path


def test_learning_reads_and_writes_no_file() -> None:
    for path in sorted((PYPROJECT.parent / "src/stepgap/learning").glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        imported = {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        imported |= {name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names}
        names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
        assert not imported & {"os", "io", "pathlib", "shutil", "tempfile", "stepgap.base.files"}, path.name
        assert "open" not in names, path.name
