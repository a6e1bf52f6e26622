"""Names and units of coordinates. They come from files of others, and are written into programs, pages and tables.

A name is an identifier, and a unit has few characters. So neither can end a comment, a string or an element in any
language that StepGap writes, and neither is a formula of a spreadsheet.
"""

import re

NAME_RULE = "consist of letters, digits and underscores, and not begin with a digit"
"""Rule for a name, as it ends the message of `require`."""

UNIT_RULE = "be a unit of at most 40 letters, digits, blanks and · * / ^ + − ( ) . % °, such as m/s or N·m/rad^2"
"""Rule for a unit, as it ends the message of `require`."""

_UNIT = re.compile(r"(?:[\w%°‰′″µ(√∞](?:[\w%°‰′″·⋅×∙*/^+−⁺⁻().√∞ -](?<!\*/)(?<!/\*)(?<!//)){0,39})?")


def is_name(text: str) -> bool:
    """Whether a text is the name of a coordinate: an identifier."""
    return text.isidentifier()


def is_unit(text: str) -> bool:
    """Whether a text is a unit; an empty one is unknown."""
    return _UNIT.fullmatch(text) is not None


def as_name(text: str) -> str:
    """The name that a text becomes, such as `hip_rad` for `hip [rad]`; a name stays as it is."""
    if is_name(text):
        return text
    words = "".join(letter if f"_{letter}".isidentifier() else " " for letter in text).split()
    joined = "_".join(words) or "_"
    return joined if is_name(joined) else f"_{joined}"
