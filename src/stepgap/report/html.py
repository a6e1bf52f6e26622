"""Elements of the pages: each a file to mail, which fetches nothing; figures are inline vector graphics.

Whatever comes from a file is untrusted and passes `safe`; a content security policy forbids fetching, and every script
but the page's own.
"""

import re
from base64 import b64encode
from collections.abc import Sequence
from hashlib import sha256
from html import escape
from importlib.resources import files
from typing import Final

from stepgap.records.missing import Missing
from stepgap.report.drawing import Drawing
from stepgap.step import Quantity

STYLE: Final = files("stepgap.report").joinpath("page.css").read_text(encoding="utf-8")
"""Of every page."""


POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src data:;"
"""What a page may fetch and run: nothing but its own styles, and images within it."""


def page(title: str, sections: Sequence[str], script: str = "") -> str:
    """A whole page.

    Args:
        title: Its title, a plain text.
        sections: HTML.
        script: JavaScript of ours, which runs when the page is there.
    """
    may_run = f" script-src 'sha256-{b64encode(sha256(script.encode()).digest()).decode()}';" if script else ""
    head = (
        f'<meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{POLICY}{may_run}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{safe(title)}</title><style>{STYLE}</style>"
    )
    end = f"<script>{script}</script>\n" if script else ""
    body = "\n".join(sections)
    return f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n{body}\n{end}</body></html>\n'


def section(name: str, title: str, *parts: str) -> str:
    """A part of a page with a heading; `name` is what links lead to."""
    body = "\n".join(part for part in parts if part)
    return f'<section id="{name}">\n<h2>{safe(title)}</h2>\n{body}\n</section>'


def safe(text: str) -> str:
    """Escaped text without control characters."""
    printable = "".join(
        letter if letter.isprintable() or letter in "\n\t" else "\N{REPLACEMENT CHARACTER}" for letter in text
    )
    return escape(printable)


def inline_svg(drawing: Drawing, prefix: str) -> str:
    """The figure as an `<svg>` element to be put into a page.

    Args:
        drawing: The figure.
        prefix: Begins every identifier, so that they are unique in the page and the same at every writing.
    """
    svg = re.sub(r"<!--.*?-->\n?", "", drawing.svg[drawing.svg.index("<svg") :], flags=re.DOTALL)
    names: dict[str, str] = {}

    def rename(match: re.Match[str]) -> str:
        return match[1] + names.setdefault(match[2], f"{prefix}{len(names)}")

    svg = re.sub(r'(\bid="|href="#|url\(#)([^")]+)', rename, svg)
    return svg.replace("<svg ", '<svg role="img" ', 1)


def picture(drawn: Drawing | Missing, prefix: str, caption: str) -> str:
    """A figure with its caption, or a sentence with the reason why there is none."""
    if isinstance(drawn, Missing):
        return paragraph(f"{drawn.reason[:1].upper()}{drawn.reason[1:]}.")
    return f"<figure>{inline_svg(drawn, prefix)}<figcaption>{safe(caption)}</figcaption></figure>"


def with_unit(quantity: Quantity) -> str:
    """Name and unit of a coordinate, as tables have it."""
    return f"{quantity.name} [{quantity.unit}]" if quantity.unit else quantity.name


def paragraph(text: str) -> str:
    """One paragraph."""
    return f"<p>{safe(text)}</p>"


def absence(part: str, missing: Missing) -> str:
    """One paragraph that says why a part is not there."""
    return paragraph(f"There is no {part}: {missing.reason}.")


def bullets(lines: Sequence[str]) -> str:
    """A list; nothing for none."""
    return f"<ul>{''.join(f'<li>{safe(line)}</li>' for line in lines)}</ul>" if lines else ""


def table(caption: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of texts; the first cell of each row is its head."""
    top = "".join(f'<th scope="col">{safe(head)}</th>' for head in heads)
    lines = [
        f'<tr><th scope="row">{safe(first)}</th>{"".join(f"<td>{safe(cell)}</td>" for cell in cells)}</tr>'
        for first, *cells in rows
    ]
    title = f"<caption>{safe(caption)}</caption>" if caption else ""
    return (
        f'<div class="wide"><table>{title}<thead><tr>{top}</tr></thead><tbody>\n'
        + "\n".join(lines)
        + "\n</tbody></table></div>"
    )
