"""The XML of an ESI file: a tree of the elements that are used.

The file comes from elsewhere, so nothing in it is trusted: its size, depth and number of elements are limited, and a
document type is refused, without which XML has neither entities to expand nor anything to fetch. This needs handlers
of expat, the parser of the standard library; `defusedxml` is a layer above the same parser. With handlers, the largest
part of a file, pictures and descriptions of objects, need not be kept either.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from xml.parsers import expat

from stepgap.base.errors import InputError, StepGapError
from stepgap.base.files import read_bounded

LARGEST_ESI_FILE = 2**26  # Largest file that is read [bytes]; those of large terminal families have some 20 MB

DEEPEST = 64  # Largest number of nested elements
MOST_KEPT = 500_000  # Largest number of elements that are kept
LONGEST_TEXT = 2**16  # Largest number of characters of one of them

STRUCTURE: Mapping[str, frozenset[str]] = MappingProxyType({
    "": frozenset({"EtherCATInfo"}),
    "EtherCATInfo": frozenset({"Vendor", "Descriptions"}),
    "Vendor": frozenset({"Id", "Name"}),
    "Descriptions": frozenset({"Devices", "Modules"}),
    "Devices": frozenset({"Device"}),
    "Modules": frozenset({"Module"}),
    "Device": frozenset({
        "Type", "Name", "Info", "Profile", "Sm", "RxPdo", "TxPdo", "Mailbox", "Dc", "Slots",
    }),
    "Module": frozenset({"Type", "Name", "RxPdo", "TxPdo", "Mailbox"}),
    "Info": frozenset({"StateMachine"}),
    "StateMachine": frozenset({"Timeout"}),
    "Timeout": frozenset({"PreopTimeout", "SafeopOpTimeout"}),
    "Profile": frozenset({"Dictionary"}),
    "Dictionary": frozenset({"Objects"}),
    "Objects": frozenset({"Object"}),
    "Object": frozenset({"Index"}),
    "RxPdo": frozenset({"Index", "Name", "Exclude", "ExcludedSm", "Entry"}),
    "TxPdo": frozenset({"Index", "Name", "Exclude", "ExcludedSm", "Entry"}),
    "Entry": frozenset({"Index", "SubIndex", "BitLen", "Name", "DataType"}),
    "Mailbox": frozenset({"CoE"}),
    "CoE": frozenset({"InitCmd", "InitCmds"}),
    "InitCmds": frozenset({"InitCmd"}),
    "InitCmd": frozenset({"Transition", "Index", "SubIndex", "Data", "DataAscii", "Comment"}),
    "Dc": frozenset({"OpMode"}),
    "OpMode": frozenset({"Name", "Desc", "AssignActivate", "CycleTimeSync0"}),
})  # fmt: skip
"""The elements that are kept, by the element around them (ETG.2000); others are skipped with all that they contain."""

MULTI_BYTE = MappingProxyType(
    {"gb2312": "gb18030", "gbk": "gb18030", "gb18030": "gb18030", "big5": "big5", "shift_jis": "cp932"}
    | dict.fromkeys(("euc-jp", "euc-kr"), "")
)
"""Encodings that expat cannot read, with the codec that can; empty if it has the same name."""

_DECLARED = re.compile(rb"""<\?xml[^>]{0,100}?encoding\s*=\s*["']([A-Za-z0-9._-]{1,40})["']""")


@dataclass
class Element:
    """An element.

    Attributes:
        name: Its name, without a namespace.
        attributes: Its attributes.
        line: Line of the file where it begins.
        text: Its text, without surrounding spaces.
        children: The kept elements in it.
    """

    name: str
    attributes: Mapping[str, str]
    line: int
    text: str = ""
    children: list["Element"] = field(default_factory=list)

    def find(self, *names: str) -> "Element | None":
        """First element on a path below this one."""
        return next(self.find_all(*names), None)

    def find_all(self, *names: str) -> Iterator["Element"]:
        """All elements on a path below this one, in the order of the file."""
        for child in self.children:
            if child.name == names[0]:
                if names[1:]:
                    yield from child.find_all(*names[1:])
                else:
                    yield child

    def text_of(self, *names: str) -> str:
        """Text of the first element on a path; empty without one."""
        element = self.find(*names)
        return element.text if element else ""


def read_tree(path: Path) -> Element:
    """Reads the tree of an ESI file.

    Raises:
        InputError: The file cannot be read, is not XML, is too large, or has a document type; the message is one line.
    """
    try:
        content = read_bounded(path, LARGEST_ESI_FILE)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; give an existing ESI file") from None
    try:
        return parse_tree(content)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


def parse_tree(content: bytes) -> Element:
    """Parses an ESI file.

    Raises:
        ValueError: As `read_tree`, without the name of the file.
    """
    declared = _DECLARED.search(content[:200])
    encoding = declared[1].decode("ascii").lower() if declared else ""
    codec = MULTI_BYTE[encoding] or encoding if encoding in MULTI_BYTE else ""
    builder = _Builder("utf-8" if codec else None)
    try:
        builder.parser.Parse(content.decode(codec).encode("utf-8") if codec else content, True)
    except expat.ExpatError as error:
        raise ValueError(_fault_of(error, content[max(builder.parser.ErrorByteIndex - 20, 0) :][:40])) from None
    except _RefusedTree:
        raise
    except (LookupError, ValueError):  # of the codec that the file names
        raise ValueError(
            f"its text cannot be read in the encoding '{encoding}' that it declares; save it as UTF-8"
        ) from None
    return builder.root()


def _fault_of(error: expat.ExpatError, around: bytes) -> str:
    """What is wrong with a file that is no XML, and what would be right, from the bytes around the place."""
    reason = f"line {error.lineno}: not XML: {expat.ErrorString(error.code)}"
    bare = re.search(rb"\w*&(?!#?\w+;)\w*", around)
    if bare and error.code == expat.errors.codes[expat.errors.XML_ERROR_INVALID_TOKEN]:
        text = bare[0].decode("latin-1")
        return f"{reason} at '{text}'; write {text.replace('&', '&amp;')} there"
    return f"{reason}; give an ESI file (.xml)"


class _RefusedTree(StepGapError, ValueError):
    """The file is beyond a limit, or has what no ESI file needs."""


class _Builder:
    """Handlers of expat that keep the elements of `STRUCTURE`."""

    def __init__(self, encoding: str | None):
        self.parser = expat.ParserCreate(encoding)
        self.parser.buffer_text = True
        self.parser.SetParamEntityParsing(expat.XML_PARAM_ENTITY_PARSING_NEVER)
        self.parser.StartDoctypeDeclHandler = self._refuse_doctype
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._add_text
        self._open = [Element("", {}, 0)]
        self._skipped = 0
        self._count = 0

    def root(self) -> Element:
        """The outermost element.

        Raises:
            ValueError: It is not that of an ESI file.
        """
        root = self._open[0].find("EtherCATInfo")
        if root is None:
            raise ValueError("its outermost element is not EtherCATInfo, so it is not an ESI file")
        return root

    def _refuse_doctype(self, *_: object) -> None:
        raise _RefusedTree(f"line {self._line}: it has a document type (DOCTYPE), which no ESI file needs; remove it")

    @property
    def _line(self) -> int:
        return self.parser.CurrentLineNumber

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        name = name.rpartition(":")[2]
        around = self._open[-1]
        if len(self._open) + self._skipped > DEEPEST:
            raise _RefusedTree(f"line {self._line}: more than {DEEPEST} elements within each other")
        if self._skipped or name not in STRUCTURE.get(around.name, ()):
            self._skipped += 1
            return
        self._count += 1
        if self._count > MOST_KEPT:
            raise _RefusedTree(f"line {self._line}: more than {MOST_KEPT} elements")
        element = Element(name, attributes, self._line)
        around.children.append(element)
        self._open.append(element)

    def _end(self, _: str) -> None:
        if self._skipped:
            self._skipped -= 1
        else:
            element = self._open.pop()
            element.text = element.text.strip()

    def _add_text(self, text: str) -> None:
        element = self._open[-1]
        if self._skipped or element.name in STRUCTURE:
            return
        element.text += text
        if len(element.text) > LONGEST_TEXT:
            raise _RefusedTree(f"line {self._line}: {element.name} has more than {LONGEST_TEXT} characters")
