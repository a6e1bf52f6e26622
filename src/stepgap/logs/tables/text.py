"""Text files of all kinds: how their numbers are written, and their columns."""

import csv
import re
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from io import StringIO
from itertools import chain, count, islice, starmap
from typing import final

import numpy as np

from stepgap.base.errors import StepGapWarning
from stepgap.logs.tables.damaged_text import (
    Row,
    aligned,
    until_next_header,
    whole_characters,
    without_cut_quote,
    without_cut_row,
    without_zeros,
)
from stepgap.logs.tables.log_table import MOST_ELEMENTS, LogColumn, LogTable, check_size, column_of_cells, number_in
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
            examples = "such as utf-8, utf-16, latin-1 or cp1252"
            raise ValueError(f"encoding = {self.encoding!r:.40}, but it must be an encoding, {examples}") from None


AS_FOUND = TextFormat()  # Everything as found in the file


def decoded(content: bytes, encoding: str, source: str) -> str:
    """The text of a file: by the given encoding, else by a byte-order mark, else UTF-8, else Latin-1.

    Zeros in a damaged file, and what flash memory has where nothing was written, are left out.

    Raises:
        RecordError: The content is not text in this encoding, or holds characters that occur in binary files only.
    """
    mark = next((name for mark, name in _BYTE_ORDER_MARKS.items() if content.startswith(mark)), "")
    if not (encoding or mark):
        content = content.rstrip(b"\xff")
    try:
        text = whole_characters(content, encoding or mark or "utf-8").removeprefix("\ufeff")
    except UnicodeError:
        text = "\0,\0" if encoding or mark else content.decode("latin-1")
    if "\0" in text and not _BINARY.search(text.replace("\0", "")):
        text = without_zeros(text, source)
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
        count = len(_words(header))
        fits = [len(_words(row)) in (count, count + 1) for row in rows]
        is_split = count > 1 and 2 * sum(fits) >= len(fits)
        return " " if is_split else ""
    counts = {one: {_unquoted(row.rstrip().removesuffix(one)).count(one) for row in rows} for one in present}
    fitting = [one for one in present if counts[one] == {_unquoted(header.rstrip().removesuffix(one)).count(one)}]
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


def _words(line: str) -> list[str]:
    """The cells of a line that are separated by spaces; those in quotation marks may have some."""
    return [word.strip('"') for word in re.findall(r'"[^"]*"|\S+', line)]


def _unquoted(line: str) -> str:
    return re.sub(r'"[^"]*"', "", line)


SAMPLED_ROWS = 50  # Rows from which the separator is found

NAMES_BELOW = "if its names are in another line, give its beginning as `header` in the table [format] of --columns"
"""What to do where the first line is not that of the names of columns."""

_STATED = re.compile('"?sep=([,;\t])"?')  # First line of some files: the separator, for spreadsheets


def read_delimited_text(text: str, written: TextFormat, source: str) -> LogTable:
    """The columns of a text with a line of column names, comments before it, and rows below it.

    Raises:
        RecordError: A row does not fit the header, or how the numbers are written is ambiguous.
    """
    names, rows = _names_and_rows(text, written, source)
    if names is None:
        raise RecordError(f"{source}: empty; it must have a line of column names and rows below it")
    line, header = names
    if not text.endswith(("\n", "\r")):
        rows = without_cut_row(rows, len(header), source)
    rows = until_next_header(header, rows, source)
    header, rows = aligned(header, rows)
    header = [name or f"column_{number}" for number, name in enumerate(header, 1)]
    for number, cells in rows:
        if len(cells) != len(header):
            hint = "; a decimal comma needs another separator" if len(cells) > len(header) else ""
            raise RecordError(
                f"{source}, line {number}: {len(cells)} values; it must have {len(header)}, as the header{hint}; "
                f"{NAMES_BELOW}"
            )
    check_size(source, len(rows) * len(header))
    rows = _without_units(rows, source)
    lines = np.array([number for number, _ in rows], np.intp)
    repeated = _repeated(header)
    numbers = {name: count() for name in repeated}
    numbered = [f"{name}[{next(numbers[name])}]" if name in repeated else name for name in header]
    columns = {name: column_of_cells([cells[at] for _, cells in rows]) for at, name in enumerate(numbered)}
    repeated |= _repeated(numbered)
    columns = dict(chain.from_iterable(starmap(_elements, columns.items())))
    check_size(source, len(rows) * len(columns))
    kept = {name: values for name, values in columns.items() if values is not None and name not in repeated}
    return LogTable(source, kept, lines, f"{source}, line {line}", repeated)


_LIST = re.compile(r"\[([^\[\]]*)\]|\(([^()]*)\)")
"""A list in a cell, as Python, NumPy and MATLAB write it: [2.4, 2.1], [2.4 2.1] or (2.4, 2.1)."""


def _elements(name: str, column: LogColumn | None) -> Iterator[tuple[str, LogColumn | None]]:
    """Yields a column of the file; if its cells are lists of numbers, their elements as NAME[0], NAME[1] and so on."""
    cells = [] if column is None or column.dtype.kind != "U" else column.tolist()
    lists = [_LIST.fullmatch(cell) for cell in cells]
    if not any(lists) or any(cell and not one for cell, one in zip(cells, lists, strict=True)):
        yield name, column
        return
    rows = [re.split(r"[,;\s]+", one[0][1:-1].strip(" \n,;")) if one else [] for one in lists]
    width = max(map(len, rows))
    if width > MOST_ELEMENTS or any(number_in(part) is None for row in rows for part in row):
        yield name, column
        return
    for index in range(width):
        yield f"{name}[{index}]", column_of_cells([row[index] if index < len(row) else "" for row in rows])


def _repeated(names: Sequence[str]) -> frozenset[str]:
    return frozenset(name for name, times in Counter(names).items() if times > 1)


def _names_and_rows(text: str, written: TextFormat, source: str) -> tuple[Row | None, list[Row]]:
    """The header and the rows below it, with decimal points."""
    lines = without_cut_quote(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), source)
    begin, comment = _beginning(lines, written)
    if stated := _STATED.fullmatch(lines[begin].strip(" ")) if begin < len(lines) else None:
        written = replace(written, delimiter=written.delimiter or stated[1])
        lines[begin] = ""
        begin, comment = _beginning(lines, written)
    if begin == len(lines):
        if written.header:
            raise RecordError(f"{source}: no line begins with {written.header!r:.40}; it is `header` in [format]")
        return None, []
    header_at = begin
    header = lines[begin]
    if _looks_like_data(header):
        if comment is None:
            raise RecordError(
                f"{source}, line {begin + 1}: {header.strip()!r:.40}; it must be a line of column names; {NAMES_BELOW}"
            )
        header_at = comment
        header = lines[comment].lstrip().removeprefix(written.comment or lines[comment].lstrip()[0])
    body = header_at + 1 if header_at == begin else begin
    samples = [line for line in islice(lines, body, body + SAMPLED_ROWS) if line.strip()]
    delimiter = written.delimiter or delimiter_of(header, samples, f"{source}, line {header_at + 1}")
    names = next(_cells(header, delimiter, header_at, source), (header_at + 1, []))
    _check_names(names, samples, source)
    rows = list(_cells("\n".join(lines[body:]), delimiter, body, source))
    if delimiter == " " and rows and all(len(cells) == len(names[1]) + 1 for _, cells in rows):
        names = names[0], ["", *names[1]]  # R gives the names of the rows no name
    cells = chain.from_iterable(cells for _, cells in rows)
    if (written.decimal or decimal_of(cells, delimiter, source)) == ",":
        rows = [(number, list(map(_with_point, row))) for number, row in rows]
    return names, rows


def _beginning(lines: Sequence[str], written: TextFormat) -> tuple[int, int | None]:
    """Index of the first line that is neither empty nor a comment, and of the last comment before it."""
    marks = (written.comment or "#", written.comment or "%")
    comment = None
    for index, line in enumerate(lines):
        if written.header:
            if line.lstrip().removeprefix('"').startswith(written.header.removeprefix('"')):
                return index, None
            continue
        if line.lstrip().startswith(marks):
            comment = index
        elif line.strip():
            return index, comment
    return len(lines), comment


def _check_names(names: Row, samples: Sequence[str], source: str) -> None:
    """Raises RecordError if a single name stands above several columns, because it is a title or a statement."""
    for one in ",;\t" if not any(names[1][1:]) else "":
        counts = {line.count(one) for line in samples[len(samples) // 2 :]}
        if len(counts) == 1 and max(counts) > 1:
            raise RecordError(f"{source}, line {names[0]}: one name, and more columns below it; {NAMES_BELOW}")


def _without_units(rows: list[Row], source: str) -> list[Row]:
    """The rows without those under the header that hold no number, such as units, if all others do in some column."""
    begin = next((at for at, (_, cells) in enumerate(rows) if any(map(_is_measured, cells))), 0)
    above = [cells for _, cells in rows[:begin]]
    below = [cells for _, cells in rows[begin:]]
    for at in range(len(rows[0][1]) if begin else 0):
        if all(number_in(row[at]) is None for row in above) and all(number_in(row[at]) is not None for row in below):
            shown = ", ".join(rows[0][1])
            warnings.warn(f"{source}, line {rows[0][0]}: left out, as units: {shown:.60}", StepGapWarning, stacklevel=2)
            return rows[begin:]
    return rows


def _is_measured(cell: str) -> bool:
    number = number_in(cell)
    return number is not None and number == number


def _looks_like_data(line: str) -> bool:
    """Whether a cell of a line is a number, whatever the separator is."""
    cells = re.split(r"[,;\t]", line)
    return any(_is_measured(cell.strip().strip('"')) for cell in (cells if len(cells) > 1 else line.split()))


def _cells(text: str, delimiter: str, first: int, source: str) -> Iterator[Row]:
    """Yields the rows that are not empty; `first` is the index of the first line."""
    if delimiter == " ":
        lines = enumerate(text.split("\n"), first + 1)
        yield from ((number, _words(line)) for number, line in lines if line.strip())
        return
    rows = csv.reader(StringIO(text, newline=""), delimiter=delimiter or "\x1f", strict=True)
    try:
        for row in rows:
            if len(row) > 1 or any(cell.strip() for cell in row):
                yield first + rows.line_num, [cell.strip() for cell in row]
    except csv.Error as error:
        right = "it must be a CSV file, whose names of columns have no line ends"
        raise RecordError(f"{source}, line {first + rows.line_num}: {error}; {right}") from None


def _with_point(cell: str) -> str:
    """A cell with a decimal point for its decimal comma."""
    return cell.replace(",", ".") if number_in(cell.replace(",", ".", 1)) is not None else cell
