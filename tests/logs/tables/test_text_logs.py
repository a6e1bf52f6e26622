"""Text logs: every way to write the same numbers is read as the same numbers, or refused; none is read as others."""

import gzip
import re
import sys
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.base.errors import InputError, StepGapWarning
from stepgap.logs.columns import read_columns
from stepgap.logs.tables.hdf5 import read_hdf5
from stepgap.logs.tables.log_table import LogTable
from stepgap.logs.tables.reading import read_log_table, read_log_tables
from stepgap.logs.tables.text import AS_FOUND, TextFormat
from stepgap.records.steps_csv import RecordError

NUMBERS = st.floats(-1e12, 1e12)
TABLES = st.integers(2, 5).flatmap(lambda width: st.lists(st.tuples(*[NUMBERS] * width), min_size=1, max_size=12))


def read(content: bytes, written: TextFormat = AS_FOUND) -> LogTable:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        path.write_bytes(content)
        return read_log_table(path, [], written)


def read_or_refused(content: bytes) -> LogTable | None:
    """The table, or None if the content was refused by one line; any other error fails the test."""
    message = ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StepGapWarning)
            return read(content)
    except RecordError as error:
        message = str(error)
    assert "log.csv" in message
    assert "\n" not in message
    return None


@settings(max_examples=150, deadline=None)
@given(
    TABLES,
    st.sampled_from([",", ";", "\t", "  "]),
    st.sampled_from([".", ","]),
    st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "latin-1"]),
    st.sampled_from(["\n", "\r\n"]),
    st.sampled_from(["", "# a comment, with numbers 1;2\n\n", "% matlab\n"]),
    st.booleans(),
    st.booleans(),
)
def test_every_way_to_write_numbers(
    rows: list[tuple[float, ...]],
    delimiter: str,
    decimal: str,
    encoding: str,
    end: str,
    comment: str,
    in_comment: bool,
    compressed: bool,
) -> None:
    if delimiter == decimal == ",":
        decimal = "."
    names = [f"µ{column}" for column in range(len(rows[0]))]
    cells = [[repr(number).replace(".", decimal) for number in row] for row in rows]
    header = ("# " if in_comment else "") + delimiter.join(names)
    text = comment + "\n".join([header, *(delimiter.join(row) for row in cells)]) + "\n"
    content = text.replace("\n", end).encode(encoding)
    content = gzip.compress(content) if compressed else content
    with_comma = [cell for row in cells for cell in row if "," in cell]
    if with_comma and all(re.fullmatch(r"-?[1-9]\d{0,2},\d{3}", cell) for cell in with_comma):
        with pytest.raises(RecordError, match="separate thousands"):
            read(content)
        return
    table = read(content)
    assert list(table.columns) == names
    for name, values in zip(names, np.array(rows).T, strict=True):
        np.testing.assert_array_equal(table.numbers(name), values)
    assert table.lines is not None
    assert np.all(np.diff(table.lines) == 1)


@settings(max_examples=150, deadline=None)
@given(st.text('0123456789,.;\t t-e#"\n', max_size=40).map(lambda text: f"t;v\n{text}") | st.text(max_size=40))
def test_any_text_gives_a_table_or_one_line(text: str) -> None:
    table = read_or_refused(text.encode("utf-8", "surrogatepass"))
    if table is None:
        return
    assert len({len(values) for values in table.columns.values()}) <= 1
    if table.columns:
        assert table.lines is not None
        assert len(table.lines) == len(table)


@settings(max_examples=40, deadline=None)
@given(st.binary(max_size=80), st.sampled_from([b"", b"\x93NUMPY\x01\x00", b"PK\x03\x04", b"\x89MCAP0\r\n", b"PAR1"]))
def test_any_bytes_give_a_table_or_one_line(content: bytes, magic: bytes) -> None:
    read_or_refused(magic + content)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(1, 999), min_size=1, max_size=5), st.integers(0, 999))
def test_a_comma_that_may_separate_thousands_is_refused_or_named(wholes: list[int], rest: int) -> None:
    content = ("t;v\n" + "".join(f"0;{whole},{rest:03}\n" for whole in wholes)).encode()
    with pytest.raises(RecordError, match="may be a decimal comma or separate thousands"):
        read(content)
    expected = [float(f"{whole}.{rest:03}") for whole in wholes]
    assert read(content, TextFormat(decimal=",")).numbers("v").tolist() == expected


@pytest.mark.parametrize(
    ("text", "columns"),
    [
        ("# t v\n0 1\n", {"t": [0], "v": [1]}),
        ("#t,v\n0,1\n", {"t": [0], "v": [1]}),
        ("# t v\n0,5 1,5\n", {"t": [0.5], "v": [1.5]}),
        ("  t   v\n  0   1\n", {"t": [0], "v": [1]}),
        ('"t, s";v\n"0,5";1,25\n', {"t, s": [0.5], "v": [1.25]}),
        ("t,v\n0,\n1,NaN\n2,-inf\n", {"t": [0, 1, 2], "v": [np.nan] * 3}),
        ("t;v\n,5;-1,5e3\n", {"t": [0.5], "v": [-1500]}),
        ("v\n0.5\n", {"v": [0.5]}),
        ("sep=;\nt;v\n0,5;1,25\n", {"t": [0.5], "v": [1.25]}),
        ('"sep=,"\nt,v\n0.5,1.25\n', {"t": [0.5], "v": [1.25]}),
        ("sep=\t\nt\tv\n0,5\t1,25\n", {"t": [0.5], "v": [1.25]}),
        (",t,v\n0,0.5,1.25\n", {"column_1": [0], "t": [0.5], "v": [1.25]}),
        ('"t" "v m"\n"1" 0.5 1.25\n"2" 1.5 2\n', {"column_1": [1, 2], "t": [0.5, 1.5], "v m": [1.25, 2]}),
    ],
)
def test_special_cases(text: str, columns: dict[str, list[float]]) -> None:
    table = read(text.encode())
    assert list(table.columns) == list(columns)
    for name, values in columns.items():
        np.testing.assert_array_equal(table.numbers(name), values)


def test_labels_are_kept() -> None:
    table = read(b"t,phase\n0,flight\n1,\n")
    assert table.columns["phase"].tolist() == ["flight", ""]
    with pytest.raises(RecordError, match=r"line 2, column 'phase': 'flight'; it must be a number"):
        table.numbers("phase")


TITLED = {
    "motion file": "Coordinates\nversion=1\n\nas in the manual\nendheader\n{}time\tx\tv\n0\t1\t2\n1\t3\t4\n",
    "padded": "walk.mot\t\t\nversion=1\t\t\n{}time\tx\tv\n0\t1\t2\n1\t3\t4\n",
    "statements": "Measurement\nWriter\t2\nSeparator\tTab\n***End***\n{}time\tx\tv\n0\t1\t2\n1\t3\t4\n",
    "a table above": "Version,1.2,Rate,100\n{}time,x,v\n0,1,2\n1,3,4\n",
}
"""Files whose first line is not that of the names."""


@pytest.mark.parametrize("above", ["", "\n", "# time is below\n"])
@pytest.mark.parametrize("name", TITLED)
def test_names_below_other_lines_are_given_by_their_beginning(name: str, above: str) -> None:
    text = TITLED[name].format(above).encode()
    table = read(text, TextFormat(header="time"))
    assert [table.numbers(one).tolist() for one in ("time", "x", "v")] == [[0, 1], [1, 3], [2, 4]]
    with pytest.raises(RecordError, match="no line begins with 'Frame'; it is `header` in "):
        read(text, TextFormat(header="Frame"))
    with pytest.raises(RecordError, match="give its beginning as `header` in the table"):
        read(text + b"2\t5\t6\n" * 9 if b"\t" in text else text)


@pytest.mark.parametrize("units", ["s;m/s;\n", "[s];[m/s];[ ]\n", "s;m/s;-\nabsolute;filtered;raw\n"])
def test_lines_of_units_below_the_names_are_left_out_and_named(units: str) -> None:
    with pytest.warns(StepGapWarning, match="line 2: left out, as units: "):
        table = read(f"t;v;phase\n{units}0,5;1,25;a\n1,0;;b\n".encode())
    np.testing.assert_array_equal(table.numbers("v"), [1.25, np.nan])
    assert table.columns["phase"].tolist() == ["a", "b"]
    assert table.row(0).endswith(f"line {2 + units.count(chr(10))}")


def test_columns_of_one_name_are_numbered() -> None:
    table = read(b"t,X,Y,X\n0,1,2,3\n1,4,5,6\n")
    assert [table.numbers(name).tolist() for name in ("X[0]", "Y", "X[1]")] == [[1, 4], [2, 5], [3, 6]]
    with pytest.raises(RecordError, match=r"more than one such column; the first is 'X\[0\]'"):
        table.numbers("X")
    unclear = read(b"X,X,X[0]\n1,2,3\n")
    assert unclear.numbers("X[1]").tolist() == [2]
    with pytest.raises(RecordError, match=r"line 1: more than one such column$"):
        unclear.numbers("X[0]")


def test_a_file_of_a_data_logger() -> None:
    """Statements, names in quotes, units, and how each value was made."""
    text = b'"TOA5","68","CR3"\n"TIMESTAMP","v","n"\n"TS","m/s","RN"\n"","Smp","Smp"\n"2012-06-07 13:00:00.05",0.5,1\n'
    with pytest.warns(StepGapWarning, match="line 3: left out, as units: TS, m/s, RN"):
        table = read(text, TextFormat(header="TIMESTAMP"))
    assert table.times("TIMESTAMP").tolist() == [1339074000.05]
    assert table.numbers("v").tolist() == [0.5]


def test_times_of_other_countries() -> None:
    """A day, a month and a year with points are clear; with strokes they are not."""
    table = read(b"Zeit;v\n01.02.2024 12:00:00,5;0,5\n01.02.2024 12:00:01;0,75\n")
    assert np.diff(table.times("Zeit")).tolist() == [0.5]
    assert table.times("Zeit")[1] == 1706788801
    for cell in ("2/1/2024 12:00:00", "12:00:00 PM"):
        with pytest.raises(
            RecordError, match=r"; it must be a number; as a time \(--time\) it must be like 2024-05-01"
        ):
            read(f"t,v\n{cell},1\n".encode()).times("t")


def test_a_log_that_another_one_is_appended_to() -> None:
    """As by a logger that lost its power and was started again."""
    with pytest.warns(StepGapWarning) as caught:
        table = read(b"t,v\n0,1\n1,2\n2,\n3\nt,v\n0,7\n")
    assert table.numbers("t").tolist() == [0, 1, 2]
    said = [str(one.message).partition("log.csv, ")[2] for one in caught]
    assert said[0] == "line 5: left out, because the log ends in the middle of it: 3"
    assert said[1].startswith("line 6: the names of the columns again; another log begins there")


def test_a_column_of_lists_does_not_hide_the_others() -> None:
    """Vectors in files of simulators: their commas are neither decimal signs nor separators of thousands."""
    table = read(b"t\tx\n0.5\t0.04,0.17,-0.2\n1.5\t1.5,2.5,3\n")
    assert table.numbers("t").tolist() == [0.5, 1.5]
    assert table.columns["x"].tolist() == ["0.04,0.17,-0.2", "1.5,2.5,3"]
    for thousands in ("1,234.5", "-12.345.678,9", "1,234,567.8e3"):
        with pytest.raises(RecordError, match="has separated thousands"):
            read(f"t\tx\n0\t{thousands}\n".encode())


def test_a_row_without_numbers_is_kept_where_it_may_be_data() -> None:
    for text in ("t,phase\n,stand\n1,hop\n", "a,b\nx,y\nz,w\n", "t,v\nfast,slow\n1,faster\nnow,2\n"):
        assert len(read(text.encode())) == text.count("\n") - 1


def test_the_format_of_a_file_of_columns(tmp_path: Path) -> None:
    file = tmp_path / "columns.toml"
    file.write_text(
        'state = ["v"]\ncommand = ["f"]\n'
        '[format]\ndecimal = ","\ndelimiter = "tab"\nencoding = "cp1252"\ncomment = "//"\n'
    )
    columns = read_columns(file, {})
    assert columns is not None
    assert columns.format == TextFormat(",", "\t", "cp1252", "//")
    table = read("// a robot\nv\t€\n1,5\t2,25\n".encode("cp1252"), columns.format)
    assert table.numbers("€").tolist() == [2.25]


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("decimal = ';'", "format.decimal = ';', but it must be '.' or ','"),
        ("delimiter = '|'", "format.delimiter = '|', but it must be one of comma, semicolon, tab, space"),
        ("decimal = ','\ndelimiter = 'comma'", "format.delimiter = ',', but it must differ from the decimal sign"),
        ("encoding = 'klingon'", "format.encoding = 'klingon', but it must be an encoding"),
        ("decimals = ','", "format.decimals: unknown key; did you mean decimal?"),
    ],
)
def test_faults_of_a_format_are_named(entry: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "columns.toml"
    file.write_text(f"state = ['v']\ncommand = ['f']\n[format]\n{entry}\n")
    with pytest.raises(InputError, match=re.escape(message)):
        read_columns(file, {})


def test_what_git_lfs_has_in_the_place_of_a_file(tmp_path: Path) -> None:
    (tmp_path / "log.mcap").write_text("version https://git-lfs.example/spec/v1\noid sha256:0\nsize 7\n")
    with pytest.raises(RecordError, match=r"log.mcap: not the file, but what Git LFS has in its place; .*git lfs pull"):
        read_log_tables(tmp_path / "log.mcap")


def test_a_package_that_is_not_installed_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "log.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(RecordError, match=r"log\.h5: this format needs h5py: .*pip install 'stepgap\[logs\]'"):
        read_hdf5(False, tmp_path / "log.h5", {})


def test_lists_in_cells_are_columns_of_their_elements(tmp_path: Path) -> None:
    """As Python, NumPy and pandas write them; a shorter list has missing elements."""
    text = 't,q,tau,note\n0,"[0.5, -1e-3, nan]",[1.5  2.],[a]\n1,"[0.25,2]",( 3 4 ),[b]\n2,,[5 6],[c]\n'
    (tmp_path / "log.csv").write_text(text)
    table = read_log_tables(tmp_path / "log.csv")[""]
    np.testing.assert_array_equal(table.numbers("q[0]"), [0.5, 0.25, np.nan])
    np.testing.assert_array_equal(table.numbers("q[1]"), [-1e-3, 2, np.nan])
    np.testing.assert_array_equal(table.numbers("tau[1]"), [2, 4, 6])
    assert table.columns["note"].tolist() == ["[a]", "[b]", "[c]"]
    assert table.fault_of("q").startswith("no column 'q'; there is t, q[0], q[1], ")
