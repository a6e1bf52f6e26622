"""How large a model would be that an XML file describes, before MuJoCo makes it."""

from math import prod
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

from stepgap.base.errors import InputError

_MOST_ELEMENTS: Final = 50_000
"""Largest number of elements; what is repeated, or in a composite, counts as often as it is made."""

DEEPEST_MODEL: Final = 200
"""Largest depth of elements within each other, and of files that include each other."""

_MOST_POINTS: Final = 2**26
"""Largest number of points of height fields and of pixels of textures."""

_REPEATED: Final = ("replicate", "composite", "flexcomp")
"""Elements that make as many others as their attribute `count` says."""

_POINTS: Final = {"hfield": ("nrow", "ncol"), "texture": ("width", "height")}
"""Attributes whose product is the number of points of an element."""

_REMEDY: Final = "more than this is not read; make it smaller"


def check_model_size(root: ET.Element, path: Path) -> None:
    """Ensures that a model has no more elements and points than a robot.

    Args:
        root: The model without includes.
        path: Its file, for messages.

    Raises:
        InputError: It has more; the message names the element.
    """
    waiting, elements, points = [(root, 1, 0)], 0, 0
    while waiting:
        element, times, depth = waiting.pop()
        if element.tag in _REPEATED:
            times *= _product(element, ("count",))
        elements += times
        points += times * _product(element, _POINTS.get(str(element.tag), ()), none=0)
        where = f"{path}: {_begin(element)}"
        if depth > DEEPEST_MODEL:
            raise InputError(f"{where}: nested more than {DEEPEST_MODEL} deep; {_REMEDY}")
        if elements > _MOST_ELEMENTS:
            raise InputError(
                f"{where}: with it the model has {elements} elements, of at most {_MOST_ELEMENTS}; {_REMEDY}"
            )
        if points > _MOST_POINTS:
            raise InputError(f"{where}: with it the model has {points} points, of at most {_MOST_POINTS}; {_REMEDY}")
        waiting.extend((child, times, depth + 1) for child in element)


def _product(element: ET.Element, keys: tuple[str, ...], none: int = 1) -> int:
    """Product of all numbers of these attributes; `none` if there is none, or one that is no number."""
    numbers = [word for key in keys for word in element.get(key, "").split()]
    try:
        return prod(max(1, int(float(word))) for word in numbers) if numbers else none
    except (OverflowError, ValueError):
        return none


def _begin(element: ET.Element) -> str:
    """The tag of an element as in the file, shortened."""
    attributes = "".join(f' {key}="{value}"' for key, value in element.items())
    return f"<{element.tag}{attributes:.80}>"
