"""The public API: what `from stepgap import …` gives, and that people and tools find it."""

import ast
import pydoc
import re
import tomllib
from pathlib import Path

import pytest

import stepgap

PAGE = Path(__file__).parents[1] / "docs" / "api.md"


def test_the_page_lists_exactly_the_public_names() -> None:
    listed = re.findall(r"^::: (\S+)$", PAGE.read_text("utf-8"), re.MULTILINE)
    assert sorted(listed) == [f"stepgap.{name}" for name in stepgap.__all__]


def test_type_checkers_see_the_same_names() -> None:
    tree = ast.parse(Path(stepgap.__file__).read_text("utf-8"))
    (checking,) = (node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in checking.body if isinstance(node, ast.ImportFrom)]
    found = {alias.asname: f"{node.module}:{alias.name}" for node in imports for alias in node.names}
    assert found == {name: f"stepgap.{module}:{name}" for name, module in stepgap._MODULES.items()}


def test_dir_shows_public_names_with_which_people_begin_and_so_does_help() -> None:
    shown = [name for name in dir(stepgap) if not name.startswith("__")]
    assert len(shown) == len(set(shown)) <= 40
    assert {*shown} <= {*stepgap.__all__, "verbs"}
    text = pydoc.plain(pydoc.render_doc(stepgap))
    for name in {*shown} - {"verbs"}:
        assert re.search(rf"^    (?:class )?{name}\b", text, re.MULTILINE), name


@pytest.mark.parametrize("name", stepgap.__all__)
def test_a_public_name_is_defined_where_it_says_and_documented(name: str) -> None:
    value = getattr(stepgap, name)
    assert value.__name__ == name
    assert value.__module__ == f"stepgap.{stepgap._MODULES[name]}"
    assert value.__doc__


def test_the_version_is_that_of_the_package() -> None:
    project = tomllib.loads((PAGE.parents[1] / "pyproject.toml").read_text("utf-8"))["project"]
    assert stepgap.__version__ == project["version"]


def test_another_name_is_refused_with_the_public_ones() -> None:
    with pytest.raises(AttributeError, match=r"stepgap has no 'ApexMaps'; its public names are .*ApexMap"):
        stepgap.ApexMaps  # noqa: B018


def test_a_former_name_is_refused_with_the_present_one() -> None:
    with pytest.raises(AttributeError, match=r"stepgap has no 'StepLog' any more; use stepgap\.Steps"):
        stepgap.StepLog  # noqa: B018
