"""The import layers of pyproject.toml hold, no modules import each other, and learning reads and writes no file."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import importlinter.api  # noqa: F401  (configures import-linter on import)
from importlinter.application import use_cases

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"
SOURCE = PYPROJECT.parent / "src"
MODULES = {
    ".".join(path.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__"): path
    for path in SOURCE.rglob("*.py")
}


def test_one_module_reads_toml() -> None:
    source = PYPROJECT.parent / "src" / "stepgap"
    readers = [path for path in source.rglob("*.py") if "tomllib" in path.read_text("utf-8")]
    assert readers == [source / "base" / "settings_file.py"], "others must use its read_toml or parse_toml"


def test_imports_point_down() -> None:
    kept = use_cases.lint_imports(config_filename=str(PYPROJECT), cache_dir=None, no_logo=True)
    assert kept, "an import points up or across; `./go lint-imports` shows it"


def imported(path: Path) -> Iterator[str]:
    """Modules of the package that a module imports anywhere: in functions and for type checkers, too."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in MODULES)
        elif isinstance(node, ast.ImportFrom) and node.module in MODULES:
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name if name in MODULES else str(node.module) for name in inner)


def test_no_modules_import_each_other_in_a_circle() -> None:
    TopologicalSorter({name: set(imported(path)) for name, path in MODULES.items()}).prepare()  # CycleError names one


def test_the_hopper_needs_few_modules_and_no_hardware() -> None:
    code = "import sys, stepgap.robots.hopper.robot; print(*(name for name in sys.modules if name in {names!r}))"
    command = [sys.executable, "-c", code.format(names=set(MODULES))]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert "stepgap.robots.hopper.robot" in loaded
    assert len(loaded) <= 85, "the model of a robot must not bring what surrounds it"
    assert not [name for name in loaded if name.startswith("stepgap.hardware")]


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
