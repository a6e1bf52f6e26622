"""One name means one thing: no public name is defined in two modules; every public object has a docstring."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "src" / "stepgap"


@cache
def modules() -> dict[str, ast.Module]:
    return {path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text("utf-8")) for path in PACKAGE.rglob("*.py")}


def names_in(target: ast.expr) -> Iterator[str]:
    return (node.id for node in ast.walk(target) if isinstance(node, ast.Name))


def defined(module: ast.Module) -> set[str]:
    """Public names that a module defines at its top level: functions, classes and constants."""
    names: set[str] = set()
    for node in module.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign):
            names |= {name for target in node.targets for name in names_in(target)}
        elif isinstance(node, ast.AnnAssign):
            names |= set(names_in(node.target))
    return {name for name in names if not name.startswith("_")}


def test_no_public_name_is_defined_in_two_modules() -> None:
    modules_of: dict[str, list[str]] = defaultdict(list)
    for path, module in sorted(modules().items()):
        for name in defined(module):
            modules_of[name].append(path)
    twice = {name: paths for name, paths in modules_of.items() if len(paths) > 1}
    found = sorted(f"{name}: {', '.join(paths)}" for name, paths in twice.items())
    assert not found, "give each its own name, or make those private that no other module uses"


def without_docstring(body: list[ast.stmt], prefix: str) -> Iterator[str]:
    """Public functions, classes and methods of a body that have none."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            if not ast.get_docstring(node) and not is_setter(node):
                yield f"{prefix}{node.name}"
            if isinstance(node, ast.ClassDef):
                yield from without_docstring(node.body, f"{prefix}{node.name}.")


def is_setter(node: ast.FunctionDef | ast.ClassDef) -> bool:
    """Whether a property that has a docstring is set by it."""
    return any(isinstance(mark, ast.Attribute) and mark.attr == "setter" for mark in node.decorator_list)


def test_every_public_object_has_a_docstring() -> None:
    found = [
        where
        for path, module in modules().items()
        for where in [
            *([] if ast.get_docstring(module) else [path]),
            *without_docstring(module.body, f"{path}: "),
        ]
    ]
    assert not found


MOST_BY_POSITION = 4


def fields_of(node: ast.ClassDef) -> int:
    """Number of fields of a named tuple; 0 of another class."""
    bases = [base.id for base in node.bases if isinstance(base, ast.Name)]
    return sum(isinstance(entry, ast.AnnAssign) for entry in node.body) if "NamedTuple" in bases else 0


def test_large_named_tuples_are_made_by_keyword() -> None:
    """Two numbers that changed places would be found by no type checker; Numba takes keywords, too, without cost."""
    classes = [node for module in modules().values() for node in ast.walk(module) if isinstance(node, ast.ClassDef)]
    large = {node.name for node in classes if fields_of(node) > MOST_BY_POSITION}
    assert "HopState" in large
    found = [
        f"{path}:{node.lineno}: {node.func.id}"
        for path, module in modules().items()
        for node in ast.walk(module)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in large
        if sum(not isinstance(value, ast.Starred) for value in node.args) > MOST_BY_POSITION
    ]
    assert not found, f"name the values, or all but the first {MOST_BY_POSITION}"
