"""ESI files: what is read of them, and that a broken or hostile one is refused in one line."""

import re
import warnings
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stepgap.base.errors import InputError, StepGapWarning
from stepgap.hardware.ethercat.esi import tree
from stepgap.hardware.ethercat.esi.comparison import compare_with_esi
from stepgap.hardware.ethercat.esi.proposal import propose
from stepgap.hardware.ethercat.esi.reader import EsiEntry, InitCommand, OpMode, parse_number, read_esi, shorten
from stepgap.hardware.ethercat.esi.tree import DEEPEST, LARGEST_ESI_FILE, LONGEST_TEXT, parse_tree
from stepgap.hardware.ethercat.pdo_sets import PDO_SETS
from stepgap.hardware.ethercat.rig_settings import Slave
from tests.hardware.ethercat.esi.esi_files import DRIVE, MODULAR, SAMPLES, TERMINAL, written

BODY = "<EtherCATInfo><Vendor><Id>1</Id></Vendor><Descriptions>{}</Descriptions></EtherCATInfo>"
DEVICE = BODY.format("<Devices><Device>{}</Device></Devices>")
TYPE = '<Type ProductCode="1">T</Type>'


def test_a_drive_is_read(tmp_path: Path) -> None:
    file = read_esi(written(tmp_path, DRIVE))
    assert (file.name, file.vendor, file.vendor_name) == ("drive.xml", 0xABC, "Example Drives")
    first, device = file.devices
    assert (first.revision, first.pdo_assign, first.has_coe, first.objects) == (0x10000, False, True, frozenset())
    assert (device.kind, device.name) == ("SD-10", "Servo drive <10 A>")
    assert (device.product, device.revision) == (0x1234, 0x20000)
    assert (device.pdo_assign, device.pdo_config, device.safeop_op_timeout) == (True, True, 9.0)
    assert device.control_bytes == (0x26, 0x22, 0x24, 0x20)
    assert device.objects == {0x6040, 0x6041, 0x605B, 0x605E, 0x6071, 0x6072, 0x6076}
    assert device.op_modes == (OpMode("DC (SYNC0)", 0x300), OpMode("Free run", 0))
    assert [pdo.index for pdo in device.outputs] == [0x1600, 0x1601, 0x1602]
    torque = device.outputs[1]
    assert torque.entries == (
        EsiEntry(0x6040, 0, 16, "Control"),
        EsiEntry(0x6071, 0, 16, "Torque"),
        EsiEntry(0x6060, 0, 8, "Mode"),
        EsiEntry(0, 0, 8),
    )
    assert (torque.fixed, torque.mandatory, torque.sync_manager, torque.excludes) == (False, False, None, {0x1600})
    assert device.outputs[2].excluded_managers == {2}
    assert (device.inputs[0].fixed, device.inputs[0].mandatory, device.inputs[0].sync_manager) == (True, True, 3)
    assert device.init_commands[2] == InitCommand(("PS",), 0x2100, 0x1A, b"\xfd\xff", True, False, "Filter")


def test_a_device_with_slots_and_one_without_mailbox_are_read(tmp_path: Path) -> None:
    modular = read_esi(written(tmp_path, MODULAR))
    assert modular.devices[0].has_slots
    (module,) = modular.modules
    assert (module.name, module.outputs[0].index, module.inputs[0].bits) == ("Torque", 0x1600, 48)
    assert module.init_commands[0].data == b"\x01"
    terminal = read_esi(written(tmp_path, TERMINAL)).devices[0]
    assert (terminal.product, terminal.has_coe, terminal.inputs[0].sync_manager) == (0x12345678, False, 0)


@pytest.mark.parametrize(
    "content",
    [
        DRIVE.encode("utf-8-sig"),
        DRIVE.replace("UTF-8", "utf-16").encode("utf-16"),
        DRIVE.replace("UTF-8", "ISO8859-1").encode("latin-1"),
        DRIVE.replace("UTF-8", "windows-1252").encode("cp1252"),
        DRIVE.replace("UTF-8", "GB2312").encode("gb2312"),
        DRIVE.replace("UTF-8", "Shift_JIS").encode("cp932"),
        DRIVE.replace("\n", "\r\n").encode(),
        DRIVE.replace("<EtherCATInfo ", '<e:EtherCATInfo xmlns:e="urn:e" ')
        .replace("</EtherCATInfo>", "</e:EtherCATInfo>")
        .encode(),
    ],
)
def test_encodings_marks_and_prefixes_change_nothing(tmp_path: Path, content: bytes) -> None:
    assert read_esi(written(tmp_path, content)) == read_esi(written(tmp_path, DRIVE, "drive.xml"))


@pytest.mark.parametrize(
    ("text", "value"), [("#x1A00", 0x1A00), ("#X0", 0), ("0x10", 16), (" 17 ", 17), ("#xFFFFFFFF", 2**32 - 1)]
)
def test_numbers(text: str, value: int) -> None:
    assert parse_number(text) == value


@pytest.mark.parametrize("text", ["", "#x", "x10", "-1", "1.5", "#x100000000", "4294967296", "9" * 5000, "١٢"])
def test_other_numbers_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"is not a number such as #x1A00 or 6656, less than 2³²$"):
        parse_number(text)


def same_name(folder: Path) -> Path:
    """Another folder for a file of the same name."""
    (folder / "same").mkdir()
    return folder / "same"


def test_numbers_with_two_prefixes_are_read_with_a_remark(tmp_path: Path) -> None:
    """Tools that make files for real devices write and accept them."""
    odd = re.sub(r"<Index>#x(?=60)", "<Index>#x0x", DRIVE).replace('ProductCode="#x', 'ProductCode="#x0x')
    assert odd.count("#x0x") > 5
    with pytest.warns(StepGapWarning, match=r"drive.xml: line \d+: #x0x0*1234 is read as #x0*1234$"):
        assert read_esi(written(tmp_path, odd)) == read_esi(written(same_name(tmp_path), DRIVE))


@pytest.mark.parametrize("broken", ['<Device><Type ProductCode="-1">Odd</Type></Device>', "<Device/>"])
def test_a_device_that_is_not_valid_does_not_hide_the_others(broken: str, tmp_path: Path) -> None:
    content = DRIVE.replace("<Devices>", f"<Devices>{broken}")
    with pytest.warns(StepGapWarning, match=r"drive.xml: left out a device or module: line \d+: "):
        assert read_esi(written(tmp_path, content)) == read_esi(written(same_name(tmp_path), DRIVE))


BROKEN = [
    (b"", "line 1: not XML: no element found"),
    (b"\0\0\0\0", "line 1: not XML"),
    (b"\xff\xfe\x00", "not XML"),
    (b"PK\x03\x04", "line 1: not XML"),
    ("<a/>", "its outermost element is not EtherCATInfo, so it is not an ESI file"),
    ("<EtherCATInfo>", "line 1: not XML: no element found"),
    ("<EtherCATInfo/>", "it has no Vendor"),
    ("<EtherCATInfo><Vendor/></EtherCATInfo>", "line 1: Vendor has no Id"),
    ("<EtherCATInfo><Vendor><Id>two</Id></Vendor></EtherCATInfo>", "line 1: Id: 'two' is not a number"),
    (
        "<EtherCATInfo>\n<Name>R&D</Name></EtherCATInfo>",
        "line 2: not XML: not well-formed (invalid token) at 'R&D'; write R&amp;D",
    ),
    ("<EtherCATInfo>\n<b>&c;</b></EtherCATInfo>", "line 2: not XML: undefined entity"),
    ('<?xml version="1.0" encoding="klingon"?><a/>', "cannot be read in the encoding 'klingon'"),
    ('<?xml version="1.0" encoding="idna"?><a/>', "cannot be read in the encoding 'idna'"),
    (b'<?xml version="1.0" encoding="gbk"?><a>\xff</a>', "cannot be read in the encoding 'gbk'"),
    (b"<EtherCATInfo>\xff</EtherCATInfo>", "line 1: not XML"),
    (DEVICE.format(""), "line 1: Device has no Type"),
    (DEVICE.format('<Type ProductCode="-1"/>'), "line 1: ProductCode of Type: '-1' is not a number"),
    (DEVICE.format(TYPE + "<RxPdo/>"), "line 1: RxPdo has no Index"),
    (DEVICE.format(TYPE + '<RxPdo Fixed="maybe"><Index>1</Index></RxPdo>'), "Fixed of RxPdo: 'maybe' is not 0, 1"),
    (DEVICE.format(TYPE + '<TxPdo Sm="x"><Index>1</Index></TxPdo>'), "Sm of TxPdo: 'x' is not a number"),
    (DEVICE.format(TYPE + "<TxPdo><Index>1</Index><Entry><Index>1</Index></Entry></TxPdo>"), "Entry has no BitLen"),
]


@pytest.mark.parametrize(("content", "message"), BROKEN)
def test_a_broken_file_is_refused(tmp_path: Path, content: str | bytes, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)) as refusal:
        read_esi(written(tmp_path, content))
    assert str(refusal.value).startswith(f"{tmp_path / 'drive.xml'}: ")
    assert "\n" not in str(refusal.value)


BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
SECRET = '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>'


@pytest.mark.parametrize("head", [BOMB, SECRET, '<!DOCTYPE EtherCATInfo SYSTEM "http://localhost/x.dtd">'])
def test_a_document_type_is_refused_before_anything_is_expanded_or_fetched(tmp_path: Path, head: str) -> None:
    with pytest.raises(InputError, match=r"line 2: it has a document type \(DOCTYPE\), which no ESI file needs"):
        read_esi(written(tmp_path, f'<?xml version="1.0"?>\n{head}<EtherCATInfo>&a;</EtherCATInfo>'))


def test_sizes_are_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match=f"more than {DEEPEST} elements within each other"):
        parse_tree(b"<a>" * 100_000)
    monkeypatch.setattr(tree, "MOST_KEPT", 1000)
    with pytest.raises(ValueError, match="more than 1000 elements"):
        parse_tree(b"<EtherCATInfo>" + b"<Vendor/>" * 1000)
    text = "x" * (LONGEST_TEXT + 1)
    with pytest.raises(ValueError, match=f"Name has more than {LONGEST_TEXT} characters"):
        parse_tree(f"<EtherCATInfo><Vendor><Name>{text}</Name></Vendor></EtherCATInfo>".encode())
    assert parse_tree(f"<EtherCATInfo><Skipped>{text}</Skipped></EtherCATInfo>".encode()).children == []
    large = tmp_path / "large.xml"
    with large.open("wb") as file:
        file.truncate(LARGEST_ESI_FILE + 1)
    with pytest.raises(InputError, match=f"large.xml: larger than {LARGEST_ESI_FILE} bytes"):
        read_esi(large)


def test_no_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no.xml: No such file or directory; give an existing ESI file"):
        read_esi(tmp_path / "no.xml")
    with pytest.raises(InputError, match="Is a directory"):
        read_esi(tmp_path)


def test_a_text_of_the_file_is_one_printable_line() -> None:
    assert shorten(" a\n\tb\x1b[31m\u202e c ") == "a b [31m c"
    assert shorten("x" * 100) == "x" * 80 + "…"


def read_and_used(path: Path) -> None:
    """Everything that is done with an ESI file."""
    file = read_esi(path)
    propose(file)
    for device in file.devices:
        slave = Slave(name="a", vendor=file.vendor, product=device.product, startup=("0x2100:1A UINT16 = 5",))
        for pdos in PDO_SETS.values():
            for finding in compare_with_esi(slave, pdos, file, 2.0, 5):
                assert "\n" not in finding.text


def refusal_of(path: Path) -> str:
    """Why a file cannot be used; empty if it can, perhaps without a device. Any other error is a failure."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StepGapWarning)
        try:
            read_and_used(path)
        except InputError as error:
            return str(error)
        return ""


@settings(deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_damage_gives_a_result_or_one_line(tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(data.draw(st.sampled_from(SAMPLES)).encode())
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(content)))
        end = min(len(content), start + data.draw(st.integers(0, 40)))
        pieces = st.sampled_from([b"", b"<", b">", b"/", b"<Index>", b"#x", b"99999", b"\x00", b"&", b'"', b"-", b" "])
        content[start:end] = data.draw(pieces | st.binary(max_size=6))
    refusal = refusal_of(written(tmp_path, bytes(content)))
    assert not refusal or ("drive.xml" in refusal and "\n" not in refusal)
