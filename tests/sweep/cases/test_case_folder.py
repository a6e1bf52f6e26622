"""The folder of a plan: results that are there whole or not at all."""

import json
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.base.errors import InputError
from stepgap.sweep.cases.case_folder import CaseFolder, checked_name
from stepgap.sweep.cases.plan import CaseResult
from tests.full_disk import FILE_TOO_LARGE, largest_file
from tests.sweep.cases.quick_cases import Squares

PLAN = Squares(2500)


@pytest.fixture
def folder(tmp_path: Path) -> CaseFolder:
    return CaseFolder(tmp_path / "out", PLAN, join=False)


def test_results_come_back_in_the_order_of_their_numbers(folder: CaseFolder) -> None:
    for number in (2001, 7, 1200):
        folder.store(number, CaseResult({"x": [number, 0.1]}, seconds=1.5, files={"a/b.txt": "β\n"}))
    assert folder.finished() == {7, 1200, 2001}
    assert [number for number, _ in folder.results()] == [7, 1200, 2001]
    assert folder.read(1200) == CaseResult({"x": [1200, 0.1]})
    assert (folder.kept(7) / "a" / "b.txt").read_text(encoding="utf-8") == "β\n"


def test_only_the_same_plan_continues_a_folder(folder: CaseFolder) -> None:
    folder.store(0, CaseResult(1))
    with pytest.raises(InputError, match="--resume"):
        CaseFolder(folder.path, PLAN, join=False)
    before = (folder.path / "plan.toml").read_bytes()
    with pytest.raises(InputError, match=r"plan\.toml: already there, but of other cases"):
        CaseFolder(folder.path, Squares(2500, name="other"), join=True)
    assert (folder.path / "plan.toml").read_bytes() == before
    assert CaseFolder(folder.path, PLAN, join=True).finished() == {0}


def test_results_of_a_changed_plan_are_refused(folder: CaseFolder) -> None:
    folder.store(1, CaseResult(1))
    (folder.path / "plan.toml").write_text(Squares(2500, name="new").files["plan.toml"])
    changed = CaseFolder(folder.path, Squares(2500, name="new"), join=True)
    with pytest.raises(InputError, match=r"00000001\.json: computed before plan\.toml, notes\.txt in .* were changed"):
        changed.read(1)


def test_a_folder_with_other_files_is_not_used(tmp_path: Path) -> None:
    (tmp_path / "results.csv").write_text("mine")
    with pytest.raises(InputError, match=r"results\.csv"):
        CaseFolder(tmp_path, PLAN, join=True)
    (tmp_path / "results.csv").rename(tmp_path / "notes.txt")
    with pytest.raises(InputError, match=r"notes\.txt"):
        CaseFolder(tmp_path, PLAN, join=False)
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_folder_whose_files_were_only_partly_written_is_completed(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text(PLAN.files["notes.txt"], encoding="utf-8")
    CaseFolder(tmp_path, PLAN, join=False)
    assert (tmp_path / "plan.toml").read_text(encoding="utf-8") == PLAN.files["plan.toml"]


def test_on_a_full_disk_a_case_has_no_result(folder: CaseFolder) -> None:
    with largest_file(1000), pytest.raises(OSError, match=FILE_TOO_LARGE) as caught:
        folder.store(3, CaseResult("x" * 5000))
    assert "00000003.json" in caught.value.filename
    assert folder.finished() == set()
    folder.store(3, CaseResult("x"))
    assert folder.finished() == {3}


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"result": 1}', b'{"failed": 3, "result": 1}', b"\xff" * 9])
def test_a_damaged_result_is_named(folder: CaseFolder, content: bytes) -> None:
    folder.store(8, CaseResult(1))
    (path,) = (folder.path / "cases").glob("*/00000008.json")
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"00000008\.json: not the result of a case"):
        folder.read(8)


@given(st.text(max_size=30))
def test_no_kept_file_leaves_its_folder(name: str) -> None:
    try:
        path = Path("/a/b") / checked_name(name)
    except InputError:
        return
    assert Path(os.path.normpath(path)).is_relative_to("/a/b")


def test_other_files_among_the_results_are_passed_over(folder: CaseFolder) -> None:
    folder.store(0, CaseResult(1))
    for name in ("x.json", "00000001.json.partial", "99999999.json", "00000002.txt"):
        (folder.path / "cases" / "00000" / name).write_text(json.dumps({}))
    assert folder.finished() == {0}
