"""Parsed HTML pages for tests."""

import re
from base64 import b64encode
from hashlib import sha256
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

VOID = {"meta", "br", "hr", "input"}
SVG = re.compile(r"<svg .*?</svg>", re.DOTALL)


class Page(HTMLParser):
    """Tags and text of a page; an element that is not properly closed is an error."""

    def __init__(self, path: Path):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.text = ""
        self.cells: list[list[tuple[str, float | None]]] = []
        self._open: list[str] = []
        self.source = path.read_text(encoding="utf-8")
        script = re.search(r"<script>(.*?)</script>", self.source, re.DOTALL)
        self.script_hash = b64encode(sha256((script[1] if script else "").encode()).digest()).decode()
        self.feed(SVG.sub("", self.source))
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.tags.append((tag, given))
        if tag not in VOID:
            self._open.append(tag)
        if tag == "tr":
            self.cells.append([])
        elif tag == "td":
            self.cells[-1].append((given.get("class", ""), None))
        elif tag == "data":
            self.cells[-1][-1] = (self.cells[-1][-1][0], float(given["value"]))

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"style", "script"} & set(self._open):
            self.text += data


def check_alone(page: Page, pictures: int = 3) -> None:
    """Asserts that the page loads and runs nothing, that its graphics are valid and its identifiers unique."""
    policy = [given["content"] for tag, given in page.tags if given.get("http-equiv") == "Content-Security-Policy"]
    assert len(policy) == 1
    assert policy[0].startswith("default-src 'none'; style-src 'unsafe-inline'; img-src data:;")
    scripts = [given for tag, given in page.tags if tag == "script"]
    assert scripts in ([{}], [{"type": "application/json", "id": "replay-data"}, {}])
    hashes = re.findall(r"script-src 'sha256-([^']+)'", policy[0])
    assert hashes == [page.script_hash] * bool(scripts)
    assert not {tag for tag, _ in page.tags} & {
        "img",
        "link",
        "iframe",
        "object",
        "embed",
        "base",
        "form",
    }
    assert not {name for _, given in page.tags for name in given if name == "src" or name.startswith("on")}
    linked = {given["href"] for _, given in page.tags if "href" in given}
    assert not [link for link in linked if not re.fullmatch(r"#.*|[\w-][\w.-]*(/[\w-][\w.-]*)*", link)], (
        "beside the page only"
    )
    drawn = [ElementTree.fromstring(text) for text in SVG.findall(page.source)]
    assert len(drawn) >= pictures
    for element in (element for picture in drawn for element in picture.iter()):
        assert element.tag.rpartition("}")[2] not in ("script", "a", "foreignObject", "image")
        for name, value in element.attrib.items():
            assert not name.startswith("on")
            assert "//" not in value
            assert not name.endswith("href") or value.startswith("#")
    names = re.findall(r'\sid="([^"]+)"', page.source)
    assert len(names) == len(set(names))
    assert set(re.findall(r'(?:href="|url\()#([^")]+)', page.source)) <= set(names)


def check_same_files(again: Path, written: Path) -> None:
    """Asserts that a folder has the files of another with the same bytes."""
    names = {path.relative_to(written) for path in written.rglob("*") if path.is_file()}
    assert {path.relative_to(again) for path in again.rglob("*") if path.is_file()} == names
    for name in names:
        assert (again / name).read_bytes() == (written / name).read_bytes(), name
