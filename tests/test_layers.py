"""The import layers of pyproject.toml hold."""

from pathlib import Path

import importlinter.api  # noqa: F401  (configures import-linter on import)
from importlinter.application import use_cases

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"


def test_imports_point_down() -> None:
    kept = use_cases.lint_imports(config_filename=str(PYPROJECT), cache_dir=None, no_logo=True)
    assert kept, "an import points up or across; `./go lint-imports` shows it"
