"""The part of YAML in which trainings write what belongs to a policy: tables, lists, numbers and texts.

Nothing in a file is called: tags, such as those of Python objects, are passed over. The lines of a text are joined.
"""

import re
from math import inf
from typing import Any, Final

_KEY: Final = re.compile(r"""("[^"]*"|'[^']*'|[^\s"'\[\]{}#][^"'\[\]{}]*?)\s*:(?:\s+|$)""")
_ITEM: Final = re.compile(r"-(?:\s+|$)")
_TEXT: Final = r""""(?:[^"\\]|\\.)*"|'(?:[^']|'')*'"""
_COMMENT: Final = re.compile(rf"({_TEXT})|(?:^|\s)#.*")
_PART: Final = re.compile(rf"\s*({_TEXT}|[\[\]{{}},]|[^\[\]{{}},\s](?:[^\[\]{{}},:]|:(?!\s))*(?::(?=\s))?)")
_MARK: Final = re.compile(r"(?:!\S*|&(?P<anchor>\S+))(?:\s+|$)")  # A tag, or a name for what follows
_NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_WORDS: Final = {"": None, "~": None, "null": None, "true": True, "false": False, ".inf": inf, "-.inf": -inf}


def parse_yaml(text: str) -> Any:
    """The value in a document of YAML: tables, lists, numbers, texts, true, false, and None.

    Args:
        text: The document.

    Raises:
        ValueError: It is not in this part of YAML; the message is the reason.
    """
    try:
        lines = _lines(text)
        document = _Document(lines)
        value = document.block(lines[0][0]) if lines else None
    except RecursionError:
        raise ValueError("its lists or tables are nested too deeply") from None
    if document.at < len(lines):
        raise ValueError(f"{lines[document.at][1]!r:.80} is neither a key, nor an item of a list")
    return value


def _lines(text: str) -> list[tuple[int, str]]:
    """Indentation and content of each line with content; a value that goes on over several lines is in one."""
    lines: list[tuple[int, str]] = []
    for line in text.splitlines():
        written = _COMMENT.sub(lambda match: match[1] or "", line).rstrip()
        content = written.lstrip()
        indent = len(written) - len(content)
        if not content or content == "---":
            continue
        starts = _KEY.match(content) or _ITEM.match(content)
        if lines and (_is_open(lines[-1][1]) or not starts):
            lines[-1] = lines[-1][0], f"{lines[-1][1]} {content}"
        else:
            lines.append((indent, content))
    return lines


def _is_open(content: str) -> bool:
    """Whether brackets or a text in quotes are not yet closed."""
    while match := _ITEM.match(content) or _KEY.match(content) or _MARK.match(content):
        content = content[match.end() :]
    if content[:1] in ("'", '"'):
        return not re.fullmatch(_TEXT, content)
    parts = _PART.findall(content) if content[:1] in ("[", "{") else []
    return sum(part in ("[", "{") for part in parts) > sum(part in ("]", "}") for part in parts)


class _Document:
    """A document, which is read from line to line.

    Args:
        lines: Indentation and content of each line.
    """

    def __init__(self, lines: list[tuple[int, str]]):
        self.at = 0
        self._lines = lines
        self._named: dict[str, Any] = {}

    def block(self, indent: int) -> Any:
        """The list, table or value whose lines have this indentation."""
        if _ITEM.match(self._lines[self.at][1]):
            items = []
            while match := self._next(indent, _ITEM):
                items.append(self._value(match, indent, indent))
            return items
        if not _KEY.match(self._lines[self.at][1]):
            self.at += 1
            return _flow(self._lines[self.at - 1][1])
        table = {}
        while match := self._next(indent, _KEY):
            table[_scalar(match[1])] = self._value(match, indent, indent - 1)
        return table

    def _next(self, indent: int, kind: re.Pattern[str]) -> re.Match[str] | None:
        here = self.at < len(self._lines) and self._lines[self.at][0] == indent
        return kind.match(self._lines[self.at][1]) if here else None

    def _value(self, match: re.Match[str], indent: int, outer: int) -> Any:
        """The value of a key or an item, which may go on in lines that are indented by more than `outer`."""
        content = match.string[match.end() :]
        start = indent + match.end()
        names = []
        while mark := _MARK.match(content):
            names.append(mark["anchor"])
            content = content[mark.end() :]
            start += mark.end()
        if match.re is _ITEM and content and (_KEY.match(content) or _ITEM.match(content)):
            self._lines[self.at] = start, content  # a table or list that begins in the line of its item
            value = self.block(start)
        else:
            self.at += 1
            value = self._below(outer) if not content else self._named.get(content[1:], None)
            if content and not content.startswith("*"):
                value = _flow(content)
        self._named |= {name: value for name in names if name}
        return value

    def _below(self, outer: int) -> Any:
        """The value in the lines that follow, if they are indented by more; a list of a key need not be."""
        if self.at == len(self._lines) or self._lines[self.at][0] <= outer:
            return None
        indent, content = self._lines[self.at]
        return self.block(indent) if indent > outer + 1 or _ITEM.match(content) else None


def _flow(content: str) -> Any:
    """The value in a text of one line, perhaps a list or table in brackets."""
    if content[0] not in "[{":
        return _scalar(content)
    parts = _PART.findall(content)[::-1]
    try:
        value = _bracketed(parts)
    except IndexError:
        raise ValueError(f"{content!r:.80} has brackets that are not closed") from None
    if parts:
        raise ValueError(f"{content!r:.80} goes on behind its last bracket")
    return value


def _bracketed(parts: list[str]) -> Any:
    """The value at the end of the parts of a text, which are in reverse order, and are taken away."""
    part = parts.pop().strip()
    if part not in ("[", "{"):
        return _scalar(part)
    items = []
    table = {}
    while parts[-1] not in ("]", "}"):
        if part == "[":
            items.append(_bracketed(parts))
        else:
            key = _scalar(parts.pop().removesuffix(":"))
            table[key] = None if parts[-1] in (",", "}") else _bracketed(parts)
        if parts[-1] == ",":
            parts.pop()
    parts.pop()
    return items if part == "[" else table


def _scalar(text: str) -> Any:
    """A number, a word with a meaning, or a text."""
    if _NUMBER.fullmatch(text):
        return float(text) if set(text) & set(".eE") else int(text)
    if re.fullmatch(_TEXT, text):
        return text[1:-1].replace("''", "'") if text[0] == "'" else text[1:-1]
    return _WORDS.get(text, text)
