"""All error types of StepGap have one root."""

import ast
import builtins
from pathlib import Path

import pytest

import stepgap
from stepgap.base.errors import InputError, StepGapError, message_of
from stepgap.base.ranges import require

PACKAGE = Path(stepgap.__file__).parent
BUILT_IN = {
    name
    for name, kind in vars(builtins).items()
    if isinstance(kind, type) and issubclass(kind, BaseException) and not issubclass(kind, Warning)
}


def test_every_error_derives_from_the_root() -> None:
    rootless = [
        f"{path.relative_to(PACKAGE)}: {node.name}"
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ClassDef) and node.name != "StepGapError"
        for bases in [{base.id for base in node.bases if isinstance(base, ast.Name)}]
        if bases & BUILT_IN and "StepGapError" not in bases
    ]
    assert not rootless


def test_bad_input_is_a_value_error_too() -> None:
    assert issubclass(InputError, StepGapError)
    assert issubclass(InputError, ValueError)


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (ValueError("speed is missing"), "speed is missing"),
        (OSError(28, "No space left on device", "steps.csv"), "steps.csv: No space left on device"),
        (OSError("no file"), "no file"),
    ],
)
def test_the_message_of_an_error_names_the_file(error: Exception, message: str) -> None:
    assert message_of(error) == message


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (-1, "-1"),
        (True, "true"),
        ("a'b", '"a\'b"'),
        (10**400, "a very large integer"),
        ("x" * 100, "'" + "x" * 59 + "…"),
    ],
)
def test_the_range_check_names_value_and_rule(value: object, text: str) -> None:
    require(True, "gain", value, "be positive")
    with pytest.raises(ValueError, match=r"^gain = ") as raised:
        require(False, "gain", value, "be positive")
    assert str(raised.value) == f"gain = {text}, but it must be positive"
