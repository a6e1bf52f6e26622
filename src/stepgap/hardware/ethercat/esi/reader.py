"""Reads an ESI file; every error is one line with the file, its line and what would be right."""

import re
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from stepgap.base.errors import InputError, StepGapWarning
from stepgap.hardware.ethercat.esi.tree import Element, read_tree


@dataclass(frozen=True)
class EsiEntry:
    """An object in a PDO.

    Attributes:
        index: Its index; 0 for padding.
        subindex: Its subindex.
        bits: Its size.
        name: Its name.
        is_real: Whether it is a number with a fraction (REAL, LREAL), which the rig neither reads nor writes.
    """

    index: int
    subindex: int
    bits: int
    name: str = ""
    is_real: bool = False


@dataclass(frozen=True)
class EsiPdo:
    """A PDO.

    Attributes:
        index: Its index.
        name: Its name.
        entries: Its contents.
        fixed: Whether the contents cannot be changed.
        mandatory: Whether it must be exchanged.
        sync_manager: Sync manager that exchanges it after power-up; None if it is not exchanged then.
        excludes: PDOs with which it cannot be exchanged.
        excluded_managers: Sync managers that cannot exchange it.
    """

    index: int
    name: str = ""
    entries: tuple[EsiEntry, ...] = ()
    fixed: bool = False
    mandatory: bool = False
    sync_manager: int | None = None
    excludes: frozenset[int] = frozenset()
    excluded_managers: frozenset[int] = frozenset()

    @property
    def bits(self) -> int:
        """Its size."""
        return sum(entry.bits for entry in self.entries)


@dataclass(frozen=True)
class InitCommand:
    """An object that a master writes by SDO when it changes the state of the device.

    Attributes:
        transitions: Changes of the state, such as PS for PREOP to SAFEOP.
        index: Index of the object.
        subindex: Its subindex.
        data: Its bytes; None if the file gives a text or something else.
        fixed: Whether a master may neither omit nor change it.
        complete_access: Whether all subindices are written at once.
        comment: What it is for.
    """

    transitions: tuple[str, ...]
    index: int
    subindex: int
    data: bytes | None
    fixed: bool = False
    complete_access: bool = False
    comment: str = ""


@dataclass(frozen=True)
class OpMode:
    """A way of synchronisation.

    Attributes:
        name: Its name, with its description.
        assign_activate: *AssignActivate*: which signals of distributed clocks it needs, 0 for none.
        cycle: Time of a cycle that the file prescribes [ns]; 0 if it is the master's.
    """

    name: str
    assign_activate: int
    cycle: int = 0


@dataclass(frozen=True)
class EsiModule:
    """A module that may be in a slot of a device.

    Attributes:
        name: Its name.
        outputs: Its PDOs from the master.
        inputs: Its PDOs to the master.
        init_commands: Objects that a master writes.
    """

    name: str
    outputs: tuple[EsiPdo, ...]
    inputs: tuple[EsiPdo, ...]
    init_commands: tuple[InitCommand, ...]


@dataclass(frozen=True)
class EsiDevice:
    """A device.

    Attributes:
        kind: Its type.
        name: Its name.
        product: Product code.
        revision: Revision number.
        outputs: PDOs from the master.
        inputs: PDOs to the master.
        has_coe: Whether it has objects that are read and written by SDO.
        pdo_assign: Whether a master may choose the PDOs (*PdoAssign*).
        pdo_config: Whether a master may write their contents (*PdoConfig*).
        init_commands: Objects that a master writes.
        op_modes: Ways of synchronisation; the first one is the default.
        control_bytes: Control byte of each sync manager; None where the file gives none.
        safeop_op_timeout: Time that it may take from SAFEOP to OP [s]; 0 if the file gives none.
        objects: Indices of all its objects; empty if the file does not describe them.
        has_slots: Whether modules determine a part of its PDOs.
    """

    kind: str
    name: str
    product: int
    revision: int
    outputs: tuple[EsiPdo, ...] = ()
    inputs: tuple[EsiPdo, ...] = ()
    has_coe: bool = False
    pdo_assign: bool = False
    pdo_config: bool = False
    init_commands: tuple[InitCommand, ...] = ()
    op_modes: tuple[OpMode, ...] = ()
    control_bytes: tuple[int | None, ...] = ()
    safeop_op_timeout: float = 0.0
    objects: frozenset[int] = frozenset()
    has_slots: bool = False


@dataclass(frozen=True)
class EsiFile:
    """An ESI file.

    Attributes:
        name: Name of the file, for messages.
        vendor: Vendor ID.
        vendor_name: Name of the vendor.
        devices: Its devices.
        modules: Modules for the slots of devices.
    """

    name: str
    vendor: int
    vendor_name: str
    devices: tuple[EsiDevice, ...]
    modules: tuple[EsiModule, ...] = ()


_Part = TypeVar("_Part")

ENGLISH = "1033"  # Language of a name (LcId) that is preferred to others

_NUMBER = re.compile(r"(?:(?:#[xX]0[xX]|[#0][xX])(?P<hex>[0-9a-fA-F]{1,16})|(?P<decimal>[0-9]{1,20}))")
_BOOLEANS = {"": False, "0": False, "false": False, "1": True, "true": True}
_LONGEST_NAME = 80


def read_esi(path: Path) -> EsiFile:
    """Reads an ESI file.

    A device or module that is not valid is left out; a `StepGapWarning` names it, and numbers such as `#x0x6041`, which
    some tools accept.

    Raises:
        InputError: It cannot be read, is not an ESI file, or none of its devices and modules is valid.
    """
    root = read_tree(path)
    if odd := next(_doubly_prefixed(root), None):
        line, text = odd
        warnings.warn(f"{path}: line {line}: {text:.30} is read as #x{text[4:]:.30}", StepGapWarning, stacklevel=2)
    try:
        vendor = root.find("Vendor")
        if vendor is None:
            raise ValueError("it has no Vendor, so it is not a complete ESI file")
        faults: list[ValueError] = []
        devices = tuple(_valid(_device, root.find_all("Descriptions", "Devices", "Device"), faults))
        modules = tuple(_valid(_module, root.find_all("Descriptions", "Modules", "Module"), faults))
        if faults and not (devices or modules):
            raise faults[0]
        file = EsiFile(path.name, _child_number(vendor, "Id"), _name_of(vendor), devices, modules)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    for fault in faults:
        warnings.warn(f"{path}: left out a device or module: {fault}", StepGapWarning, stacklevel=2)
    return file


def _valid(read: Callable[[Element], _Part], elements: Iterable[Element], faults: list[ValueError]) -> Iterator[_Part]:
    """Yields what the valid ones of some elements describe; the errors of others are added to `faults`."""
    for element in elements:
        try:
            yield read(element)
        except ValueError as error:
            faults.append(error)


def _doubly_prefixed(element: Element) -> Iterator[tuple[int, str]]:
    """Yields the numbers with two prefixes, each with its line."""
    for text in (element.text, *element.attributes.values()):
        if text[1:4].lower() == "x0x" and _NUMBER.fullmatch(text):
            yield element.line, text
    for child in element.children:
        yield from _doubly_prefixed(child)


def parse_number(text: str) -> int:
    """Parses a number of an ESI file, `#x1A00` or `6656`; one from 0 to 2³² − 1.

    Raises:
        ValueError: It is another text.
    """
    match = _NUMBER.fullmatch(text.strip())
    value = 2**32
    if match and match["hex"]:
        value = int(match["hex"], 16)
    elif match:
        value = int(match["decimal"])
    if value >= 2**32:
        raise ValueError(f"'{shorten(text, 30)}' is not a number such as #x1A00 or 6656, less than 2³²")
    return value


def shorten(text: str, most: int = _LONGEST_NAME) -> str:
    """Makes a text of a file one printable line of limited length."""
    line = " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
    return line if len(line) <= most else f"{line[:most]}…"


def _device(element: Element) -> EsiDevice:
    kind = element.find("Type")
    coe = element.find("Mailbox", "CoE")
    if kind is None:
        raise ValueError(f"line {element.line}: Device has no Type")
    timeout = element.find("Info", "StateMachine", "Timeout", "SafeopOpTimeout")
    objects = element.find_all("Profile", "Dictionary", "Objects", "Object", "Index")
    return EsiDevice(
        kind=shorten(kind.text),
        name=_name_of(element),
        product=_attribute_number(kind, "ProductCode") or 0,
        revision=_attribute_number(kind, "RevisionNo") or 0,
        outputs=tuple(map(_pdo, element.find_all("RxPdo"))),
        inputs=tuple(map(_pdo, element.find_all("TxPdo"))),
        has_coe=coe is not None,
        pdo_assign=coe is not None and _flag(coe, "PdoAssign"),
        pdo_config=coe is not None and _flag(coe, "PdoConfig"),
        init_commands=_init_commands(element),
        op_modes=tuple(map(_op_mode, element.find_all("Dc", "OpMode"))),
        control_bytes=tuple(_attribute_number(manager, "ControlByte") for manager in element.find_all("Sm")),
        safeop_op_timeout=_number(timeout) / 1000 if timeout else 0.0,
        objects=frozenset(map(_number, objects)),
        has_slots=element.find("Slots") is not None,
    )


def _module(element: Element) -> EsiModule:
    return EsiModule(
        name=_name_of(element) or shorten(element.text_of("Type")),
        outputs=tuple(map(_pdo, element.find_all("RxPdo"))),
        inputs=tuple(map(_pdo, element.find_all("TxPdo"))),
        init_commands=_init_commands(element),
    )


def _pdo(element: Element) -> EsiPdo:
    return EsiPdo(
        index=_child_number(element, "Index"),
        name=_name_of(element),
        entries=tuple(map(_entry, element.find_all("Entry"))),
        fixed=_flag(element, "Fixed"),
        mandatory=_flag(element, "Mandatory"),
        sync_manager=_attribute_number(element, "Sm"),
        excludes=frozenset(map(_number, element.find_all("Exclude"))),
        excluded_managers=frozenset(map(_number, element.find_all("ExcludedSm"))),
    )


def _entry(element: Element) -> EsiEntry:
    index = _child_number(element, "Index")
    subindex = element.find("SubIndex")
    return EsiEntry(
        index=index,
        subindex=_number(subindex) if subindex and index else 0,
        bits=_child_number(element, "BitLen"),
        name=_name_of(element),
        is_real=element.text_of("DataType") in ("REAL", "LREAL"),
    )


def _init_commands(element: Element) -> tuple[InitCommand, ...]:
    """Those of a device or module, which some files have in an element of their own."""
    return tuple(
        InitCommand(
            transitions=tuple(transition.text for transition in command.find_all("Transition")),
            index=_child_number(command, "Index"),
            subindex=_child_number(command, "SubIndex"),
            data=_data(command.text_of("Data")),
            fixed=_flag(command, "Fixed"),
            complete_access=_flag(command, "CompleteAccess"),
            comment=shorten(command.text_of("Comment")),
        )
        for path in (("InitCmd",), ("InitCmds", "InitCmd"))
        for command in element.find_all("Mailbox", "CoE", *path)
    )


def _data(text: str) -> bytes | None:
    try:
        return bytes.fromhex(text) or None
    except ValueError:
        return None


def _op_mode(element: Element) -> OpMode:
    cycle = element.find("CycleTimeSync0")
    scaled = cycle is not None and cycle.attributes.get("Factor", "1") not in ("0", "")
    activate = element.find("AssignActivate")
    description = shorten(element.text_of("Desc"))
    return OpMode(
        name=shorten(element.text_of("Name")) + (f" ({description})" if description else ""),
        assign_activate=_number(activate) if activate else 0,
        cycle=_number(cycle) if cycle and cycle.text and not scaled else 0,
    )


def _name_of(element: Element) -> str:
    """The name of something, in English if there are several."""
    names = list(element.find_all("Name"))
    english = [name for name in names if name.attributes.get("LcId") == ENGLISH]
    return shorten((english or names)[0].text) if names else ""


def _child_number(element: Element, name: str) -> int:
    child = element.find(name)
    if child is None:
        raise ValueError(f"line {element.line}: {element.name} has no {name}")
    return _number(child)


def _number(element: Element) -> int:
    try:
        return parse_number(element.text)
    except ValueError as error:
        raise ValueError(f"line {element.line}: {element.name}: {error}") from None


def _attribute_number(element: Element, name: str) -> int | None:
    text = element.attributes.get(name, "").strip()
    try:
        return parse_number(text) if text else None
    except ValueError as error:
        raise ValueError(f"line {element.line}: {name} of {element.name}: {error}") from None


def _flag(element: Element, name: str) -> bool:
    text = element.attributes.get(name, "").strip().lower()
    if text not in _BOOLEANS:
        raise ValueError(
            f"line {element.line}: {name} of {element.name}: '{shorten(text, 30)}' is not 0, 1, true or false"
        )
    return _BOOLEANS[text]
