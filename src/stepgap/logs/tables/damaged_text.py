"""What is left out of text logs that ended badly: a program was killed, the power failed, or a disk was full."""

import re
import warnings

from stepgap.base.errors import StepGapWarning
from stepgap.logs.tables.log_table import number_in

_LONGEST_CHARACTER = 4  # Largest number of bytes of a character
_ENOUGH_ROWS = 10  # Smallest number of rows that show how many decimals a number has
_MOST_DAMAGED = 0.01  # If zeros are in a larger part of the lines, the file is no text

Row = tuple[int, list[str]]
"""Number of a line, and its cells."""


def whole_characters(content: bytes, encoding: str) -> str:
    """Decodes bytes without a character in whose middle they end.

    Raises:
        UnicodeError: They are not text in this encoding.
    """
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as error:
        if error.end < len(content) or error.start < max(1, len(content) + 1 - _LONGEST_CHARACTER):
            raise
        return content[: error.start].decode(encoding)


def without_zeros(text: str, source: str) -> str:
    """A text without the zeros that are in a file where nothing was written: at its end, or in a few of its lines.

    A `StepGapWarning` names the lines. Zeros in the first line, or in many lines, stay: they are those of other files.
    """
    whole = text.rstrip("\0")
    lines = whole.split("\n")
    damaged = [at for at, line in enumerate(lines) if "\0" in line]
    if not whole or 0 in damaged or len(damaged) > _MOST_DAMAGED * len(lines):
        return text
    if len(whole) < len(text):
        _warn(f"{source}, line {len(lines)}: left out {len(text) - len(whole)} zero bytes at the end of the file")
    if damaged:
        more = f"; and {len(damaged) - 1} more such lines" if len(damaged) > 1 else ""
        _warn(f"{source}, line {damaged[0] + 1}: left out, with zero bytes in it{more}")
    for at in damaged:
        lines[at] = ""
    return "\n".join(lines)


def without_cut_quote(lines: list[str], source: str) -> list[str]:
    """Lines without the last one if it ends in the middle of a quoted cell."""
    if lines and lines[-1].count('"') % 2 and not sum(line.count('"') for line in lines[:-1]) % 2:
        warn_of_cut(source, len(lines), lines[-1])
        return [*lines[:-1], ""]
    return lines


def without_cut_row(rows: list[Row], width: int, source: str) -> list[Row]:
    """The rows of a file that has no line end at its end, without the last one if it was cut off.

    It has fewer cells than there are columns, or its last cell is no number where those of all others are, or has fewer
    decimals than they have.
    """
    if len(rows) < 2:
        return rows
    number, cells = rows[-1]
    others = [row[-1] for _, row in rows[:-1] if row]
    is_word = number_in(cells[-1]) is None and all(number_in(cell) is not None for cell in others)
    is_short = len(others) >= _ENOUGH_ROWS and 0 <= _decimals(cells[-1]) < min(map(_decimals, others))
    if len(cells) >= width and not is_word and not is_short:
        return rows
    warn_of_cut(source, number, ", ".join(cells))
    return rows[:-1]


def _decimals(cell: str) -> int:
    """Number of letters after the decimal sign; 0 without one, -1 for an empty cell."""
    return len(re.split("[.,]", cell, maxsplit=1)[-1]) if re.search("[.,]", cell) else -(not cell)


def until_next_header(header: list[str], rows: list[Row], source: str) -> list[Row]:
    """The rows before the names of the columns come again, because another log was appended."""
    again = next((at for at, (_, cells) in enumerate(rows) if cells == header), len(rows))
    if again in (0, len(rows)):
        return rows
    last = rows[again - 1][1]
    if len(last) < len(header):
        warn_of_cut(source, rows[again - 1][0], ", ".join(last))
    more = "another log begins there; split the file to read it"
    _warn(f"{source}, line {rows[again][0]}: the names of the columns again; {more}")
    return rows[: again - (len(last) < len(header))]


def aligned(header: list[str], rows: list[Row]) -> tuple[list[str], list[Row]]:
    """Names and rows without the empty cells that follow a separator at the end of a line."""
    width = max((len(cells) for _, cells in rows), default=len(header))
    if not any(header[width:]):
        header = header[:width]
    width = len(header)
    return header, [(number, cells[:width] if not any(cells[width:]) else cells) for number, cells in rows]


def warn_of_cut(source: str, number: int, line: str) -> None:
    """Warns that the last line, with this number, is left out."""
    _warn(f"{source}, line {number}: left out, because the log ends in the middle of it: {line:.60}")


def _warn(message: str) -> None:
    warnings.warn(message, StepGapWarning, stacklevel=3)
