"""A portable controller as one Python file that needs NumPy alone: a `StepFilter`, what it uses, and the model.

Of each module only what is used is taken, as it is written there, so that nothing is described twice. Annotations are
not evaluated in such a file: what they alone name is left out.
"""

import ast
import json
import sys
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Final, NamedTuple

from stepgap.base.versions import versions_here
from stepgap.export.controller.model_document import model_document
from stepgap.export.controller.passport import passport_lines
from stepgap.export.controller.portable_controller import PortableController

PERMITTED: Final = frozenset({*sys.stdlib_module_names, "numpy"})  # Packages that the file may import
COPIED_PACKAGE: Final = "stepgap"  # Package whose definitions are copied


class Place(NamedTuple):
    """Where something is defined.

    Attributes:
        module: Name of the module.
        name: Its name there.
    """

    module: str
    name: str


class _Module(NamedTuple):
    """A module.

    Attributes:
        definitions: The text of each name, and the names that it refers to, but for annotations.
        imports: The line of each name that is imported from elsewhere.
        copied: Where each name is defined that is imported from the package.
    """

    definitions: dict[str, tuple[str, list[str]]]
    imports: dict[str, str]
    copied: dict[str, Place]


FILTER: Final = "stepgap.export.controller.step_filter"  # Module of the filter

INSTEAD: Final = {
    Place("stepgap.control.gauss_newton", "_gesv"): Place(FILTER, "solved_square"),
    Place("stepgap.base.compiled", "compiled"): Place(FILTER, "uncompiled"),
}
"""What takes the place of functions that need more than NumPy, or much more than the filter does."""

USE: Final = """
    from controller import MODEL, StepFilter

    controller = StepFilter(MODEL)
    command = None
    while True:
        ...  # measure the state, and choose the target; state = None if there is none, or if it is too old
        status, command, predicted, std = controller.plan(state, target, command)
        ...  # make the step with this command, whatever the status is; measure next_state
        controller.update(state, command, next_state)
"""


def python_source(controller: PortableController) -> str:
    """Writes a controller as a Python file.

    Args:
        controller: The controller.

    Raises:
        InputError: As of `model_document`.
    """
    document = model_document(controller)
    for part in document["residual"]["regressions"]:
        del part["data"]
    if document["beliefs"] is not None:
        del document["beliefs"]["steps"], document["beliefs"]["constants"], document["beliefs"]["probes"]
    space = controller.space
    notes = [*controller.approximations, *controller.notes]
    lines = [
        "A step controller that was learned by StepGap: the command with which the next state is a target.",
        *passport_lines(controller.passport),
        "",
        f"Written by StepGap {versions_here()['stepgap']}; the code is part of it (MIT licence). It needs NumPy alone.",
        "",
        *(
            f"State: {quantity.name} [{quantity.unit}], range of use {quantity.lower:g} to {quantity.upper:g}"
            for quantity in space.state
        ),
        *(
            f"Command: {quantity.name} [{quantity.unit}], bounds {quantity.lower:g} to {quantity.upper:g}"
            for quantity in space.command
        ),
        USE,
        *(f"- {note}" for note in notes),
    ]
    head = "\n".join(lines).replace("\\", "\\\\").replace('"""', "'''")
    code = one_file([Place(FILTER, "StepFilter")], INSTEAD)
    model = f"MODEL = json.loads(\n    {json.dumps(document, allow_nan=False)!r}\n)"
    return (
        f'"""{head}\n"""\n\n{code}\n\nimport json\n\n{model}\n"""The documented model, which `StepFilter` reads."""\n'
    )


def one_file(roots: list[Place], instead: Mapping[Place, Place]) -> str:
    """Text of the definitions, behind those that they need, and behind the imports.

    Args:
        roots: What is wanted.
        instead: What takes the place of a definition.

    Raises:
        ValueError: Two definitions have one name, or something needs another package than NumPy.
    """
    modules = dict[str, _Module]()
    parts = dict[str, None]()
    imports = set[str]()
    origins = dict[str, str]()

    def add(place: Place) -> None:
        if place.name in origins:
            if origins[place.name] != place.module:
                raise ValueError(f"{place.name} is a name in {origins[place.name]} and in {place.module}")
            return
        origins[place.name] = place.module
        if place in instead:
            add(instead[place])
            parts[f"{place.name} = {instead[place].name}"] = None
            return
        if place.module not in modules:
            modules[place.module] = _read(place.module)
        module = modules[place.module]
        text, needs = module.definitions[place.name]
        for name in needs:
            if name in module.copied:
                add(module.copied[name])
            elif name in module.definitions:
                add(Place(place.module, name))
            elif name in module.imports:
                imports.add(module.imports[name])
        parts[text] = None

    for root in roots:
        add(root)
    for line in imports:
        if line.split()[1].split(".")[0] not in PERMITTED:
            raise ValueError(f"'{line}': the file has NumPy alone")
    ordered = sorted(imports, key=lambda line: ("numpy" in line, line.startswith("from"), line))
    return "\n".join(["from __future__ import annotations", "", *ordered]) + "\n\n\n" + "\n\n\n".join(parts) + "\n"


def _read(name: str) -> _Module:
    spec = find_spec(name)
    module = _Module({}, {}, {})
    if spec is None or spec.origin is None:
        raise ValueError(f"there is no module {name}")
    text = Path(spec.origin).read_text("utf-8")
    body = ast.parse(text).body
    lines = text.splitlines()
    for number, node in enumerate(body):
        if isinstance(node, ast.Import | ast.ImportFrom):
            _note_imports(node, module)
            continue
        after = body[number + 1] if number + 1 < len(body) else None
        last = after if isinstance(after, ast.Expr) and isinstance(node, ast.Assign | ast.AnnAssign) else node
        decorators = getattr(node, "decorator_list", [])
        first = min([node.lineno, *(decorator.lineno for decorator in decorators)])
        written = "\n".join(lines[first - 1 : last.end_lineno])
        module.definitions.update(dict.fromkeys(_defined(node), (written, list(dict.fromkeys(_names(node))))))
    return module


def _note_imports(node: ast.Import | ast.ImportFrom, module: _Module) -> None:
    for alias in node.names:
        name = alias.asname or alias.name
        renamed = f" as {alias.asname}" if alias.asname else ""
        if isinstance(node, ast.Import):
            module.imports[name] = f"import {alias.name}{renamed}"
        elif (node.module or "").split(".")[0] == COPIED_PACKAGE:
            module.copied[name] = Place(node.module or "", alias.name)
        else:
            module.imports[name] = f"from {node.module} import {alias.name}{renamed}"


def _defined(node: ast.stmt) -> Iterator[str]:
    """Names that a statement of a module defines."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        yield node.name
    targets = list[ast.expr]()
    if isinstance(node, ast.Assign):
        targets = node.targets
    elif isinstance(node, ast.AnnAssign):
        targets = [node.target]
    for target in targets:
        yield from (part.id for part in ast.walk(target) if isinstance(part, ast.Name))


def _names(node: ast.AST) -> Iterator[str]:
    """Names that a statement refers to when it is executed; annotations are not."""
    if isinstance(node, ast.Name):
        yield node.id
    for key, value in ast.iter_fields(node):
        if key not in ("annotation", "returns"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _names(child)
