"""How the numbers of a text file are written: encoding, comments, separator, decimal sign."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import final

from stepgap.records.steps_csv import RecordError

DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "space": " "}
"""Separators of columns by name; `space` is any run of spaces and tabs."""

_BYTE_ORDER_MARKS = {
    b"\xef\xbb\xbf": "utf-8-sig",
    b"\xff\xfe\x00\x00": "utf-32",
    b"\x00\x00\xfe\xff": "utf-32",
    b"\xff\xfe": "utf-16",
    b"\xfe\xff": "utf-16",
}
_DECIMAL_COMMA = re.compile(r"[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
_DECIMAL_POINT = re.compile(r"[+-]?(\d+\.\d*|\.\d+)([eE][+-]?\d+)?")
_BOTH = re.compile(r"[+-]?[1-9]\d{0,2}((,\d{3})+\.\d*|(\.\d{3})+,\d*)([eE][+-]?\d+)?")
_BINARY = re.compile(r"[\x00-\x08\x0e-\x1b\x7f-\x9f]")


@final
@dataclass(frozen=True)
class TextFormat:
    """How the numbers of a text file are written; an empty string means: as found in the file, if it is unambiguous.

    Attributes:
        decimal: Decimal sign, "." or ",".
        delimiter: Separator of the columns: ",", ";", a tab, or " " for any run of spaces; or a name in `DELIMITERS`.
        encoding: Name of the encoding, such as "latin-1".
        comment: Beginning of the lines before the header that are comments, instead of "#" and "%".
        header: Beginning of the line of column names; all lines before it are left out.
    """

    decimal: str = ""
    delimiter: str = ""
    encoding: str = ""
    comment: str = ""
    header: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "delimiter", DELIMITERS.get(self.delimiter, self.delimiter))
        if self.decimal not in ("", ".", ","):
            raise ValueError(f"decimal = {self.decimal!r:.40}, but it must be '.' or ','")
        if self.delimiter not in ("", *DELIMITERS.values()):
            names = ", ".join(DELIMITERS)
            raise ValueError(f"delimiter = {self.delimiter!r:.40}, but it must be one of {names}")
        if self.delimiter == self.decimal == ",":
            raise ValueError("delimiter = ',', but it must differ from the decimal sign")
        try:
            b"ab".decode(self.encoding or "utf-8", "replace")
        except (LookupError, UnicodeError):
            known = "such as utf-8, utf-16, latin-1 or cp1252"
            raise ValueError(f"encoding = {self.encoding!r:.40}, but it must be an encoding, {known}") from None


AS_FOUND = TextFormat()  # Everything as found in the file


def decoded(content: bytes, encoding: str, source: str) -> str:
    """The text of a file: by the given encoding, else by a byte-order mark, else UTF-8, else Latin-1.

    Raises:
        RecordError: The content is not text in this encoding, or holds characters that occur in binary files only.
    """
    mark = next((name for mark, name in _BYTE_ORDER_MARKS.items() if content.startswith(mark)), "")
    try:
        text = content.decode(encoding or mark or "utf-8").removeprefix("\ufeff")
    except UnicodeError:
        text = "\0" if encoding or mark else content.decode("latin-1")
    if _BINARY.search(text):
        right = f"in {encoding or mark}" if encoding or mark else "in UTF-8, UTF-16 or Latin-1, else name its encoding"
        raise RecordError(f"{source}: not a text file {right}, nor any other known format of logs")
    return text


def delimiter_of(header: str, rows: Sequence[str], source: str) -> str:
    """The separator of the columns; empty for a single column.

    Of several separators in the header, only those are possible that give the first rows as many cells.

    Raises:
        RecordError: Two separators, or none of those in the header, are possible.
    """
    present = [one for one in (",", ";", "\t") if one in _unquoted(header)]
    if len(present) == 1:
        return present[0]
    if not present:
        count = len(header.split())
        fits = [len(row.split()) == count for row in rows]
        is_split = count > 1 and 2 * sum(fits) >= len(fits)
        return " " if is_split else ""
    fitting = [one for one in present if {_unquoted(row).count(one) for row in rows} == {_unquoted(header).count(one)}]
    if len(fitting) != 1:
        names = " and ".join(name for name, one in DELIMITERS.items() if one in present)
        raise RecordError(
            f"{source}: the header has {names}, and the rows do not show which separates the columns; "
            "give `delimiter` in the table [format] of --columns"
        )
    return fitting[0]


def decimal_of(cells: Iterable[str], delimiter: str, source: str) -> str:
    """The decimal sign of cells that hold numbers, "." or ",".

    Raises:
        RecordError: Both signs occur, thousands may be separated, or a comma may separate columns.
    """
    commas = points = False
    grouped = True
    example = ""
    for cell in cells:
        if "," in cell:
            if _DECIMAL_COMMA.fullmatch(cell) or _THOUSANDS.fullmatch(cell):
                commas = True
                example = example or cell
                grouped &= _THOUSANDS.fullmatch(cell) is not None
                if cell.count(",") > 1:
                    raise _ambiguous(source, cell, "has separated thousands, which are not read")
            elif "." in cell and _BOTH.fullmatch(cell):
                raise _ambiguous(source, cell, "has separated thousands, which are not read")
        elif "." in cell:
            points = points or _DECIMAL_POINT.fullmatch(cell) is not None
    if commas and points:
        raise _ambiguous(source, example, "has a decimal comma, but other numbers have a decimal point")
    if commas and not delimiter:
        raise _ambiguous(source, example, "has a comma that may separate columns or be a decimal comma")
    if commas and grouped:
        raise _ambiguous(source, example, "has a comma that may be a decimal comma or separate thousands")
    return "," if commas else "."


def _ambiguous(source: str, cell: str, fault: str) -> RecordError:
    return RecordError(
        f"{source}: {cell!r:.40} {fault}; give `decimal` or `delimiter` in the table [format] of --columns"
    )


def _unquoted(line: str) -> str:
    """A line without what is in quotes."""
    return re.sub(r'"[^"]*"', "", line)
