"""`stepgap rig esi`, and ESI files in `stepgap rig check` before anything is connected."""

import json
from pathlib import Path

import pytest

from stepgap.base.errors import InputError
from stepgap.hardware.commissioning.check import checked
from tests.cli.command_line import Command, refused
from tests.hardware.ethercat.esi.esi_files import DRIVE, written

EXAMPLE = Path(__file__).parents[3] / "examples" / "rig.toml"


def test_what_a_rig_needs_is_printed(stepgap: Command, tmp_path: Path) -> None:
    result = stepgap("rig", "esi", str(written(tmp_path, DRIVE)))
    assert (result.code, result.err) == (0, "")
    assert "product = 0x00001234" in result.out
    assert 'pdos = "sd-10-torque"' in result.out
    assert stepgap("rig", "esi", str(tmp_path / "drive.xml"), "--product", "0x1234").out == result.out


def test_another_file_and_another_product_are_refused(stepgap: Command, tmp_path: Path) -> None:
    path = written(tmp_path, DRIVE)
    refused(stepgap("rig", "esi", str(path), "--product", "7"), "--product 7: drive.xml has 0x00001234")
    refused(stepgap("rig", "esi", str(EXAMPLE)), "rig.toml: line 1: not XML", "give an ESI file")
    refused(stepgap("rig", "esi", str(tmp_path / "none.xml")), "none.xml: No such file or directory")


def rig_with_esi(folder: Path, esi: str) -> Path:
    """The example, whose first drive has an ESI file; its interface does not exist."""
    text = EXAMPLE.read_text("utf-8").replace('"eth0"', '"no-interface"')
    path = folder / "rig.toml"
    path.write_text(text.replace('name = "left drive"\n', f'name = "left drive"\nesi = "{esi}"\n', 1), "utf-8")
    return path


def test_settings_that_contradict_an_esi_file_are_not_measured(stepgap: Command, tmp_path: Path) -> None:
    written(tmp_path, DRIVE.replace("#x00000ABC", "#x9A").replace("#x00001234", "#x00030924"))
    rig_file = rig_with_esi(tmp_path, "drive.xml")
    result = stepgap("rig", "check", str(rig_file))
    assert result.code == 1
    lines = result.out.splitlines()
    label = "slave 1 'left drive', drive.xml: "
    assert f"error   {label}pdos: there is no PDO 0x160B among the outputs, which are 0x1600, 0x1601, 0x1602" in lines
    assert f'error   {label}startup: the file writes 0x2101:00, which is missing; add "0x2101:00 UINT8 = 1"' in lines
    assert any(line.startswith(f"remark  {label}the control byte 0x24") for line in lines)
    assert lines[-2] == "result  not passed: rig.toml contradicts ESI files of the devices; nothing was measured"
    proof = json.loads((tmp_path / "rig.check.json").read_text("utf-8"))
    assert (proof["passed"], len(proof["contradictions"])) == (False, sum(line.startswith("error") for line in lines))
    with pytest.raises(InputError, match="not passed"):
        checked(rig_file)


def test_a_file_that_is_missing_is_named(stepgap: Command, tmp_path: Path) -> None:
    refused(stepgap("rig", "check", str(rig_with_esi(tmp_path, "missing.xml"))), "missing.xml: No such file")
