"""HTML elements of the pages: a page is a single file that loads nothing; figures are inline vector graphics.

All text from files is untrusted and passes through `safe`; a content security policy forbids loading, and all scripts
except the page's own.
"""

import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from hashlib import sha256
from html import escape
from importlib.resources import files
from typing import Final

from stepgap.records.missing import Missing
from stepgap.report.drawing import HOVER_SCRIPT, Drawing

STYLE: Final = files("stepgap.report").joinpath("page.css").read_text(encoding="utf-8")
"""Style sheet of every page."""

PRINT_SCRIPT: Final = files("stepgap.report").joinpath("print.js").read_text(encoding="utf-8")
"""Script of every page that opens its closed parts while it is printed."""

POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src data:;"
"""Content security policy of a page: only its own styles, and images within it."""

NO_LINKS: Final[Mapping[str, str]] = {}  # No cell of a table is a link


def page(title: str, sections: Sequence[str], script: str = "") -> str:
    """HTML of a complete page.

    Args:
        title: Title, as plain text.
        sections: HTML of the sections.
        script: JavaScript of the page itself, which runs after the page is loaded, besides those of every page.
    """
    script = HOVER_SCRIPT + PRINT_SCRIPT + script
    script_source = f" script-src 'sha256-{b64encode(sha256(script.encode()).digest()).decode()}';"
    head = (
        f'<meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{POLICY}{script_source}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{safe(title)}</title><style>{STYLE}</style>"
    )
    body = "\n".join(sections)
    end = f"<script>{script}</script>"
    return f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n{body}\n{end}\n</body></html>\n'


def section(name: str, title: str, *parts: str) -> str:
    """Section of a page with a heading; `name` is its anchor."""
    body = "\n".join(part for part in parts if part)
    return f'<section id="{name}">\n<h2>{safe(title)}</h2>\n{body}\n</section>'


def safe(text: str) -> str:
    """Escaped text without control characters."""
    printable = "".join(
        letter if letter.isprintable() or letter in "\n\t" else "\N{REPLACEMENT CHARACTER}" for letter in text
    )
    return escape(printable)


def inline_svg(drawing: Drawing, prefix: str) -> str:
    """The figure as an `<svg>` element for a page.

    Args:
        prefix: Prefix of all identifiers, so that they are unique in the page and always the same.
    """
    svg = re.sub(r"<!--.*?-->\n?", "", drawing.svg[drawing.svg.index("<svg") :], flags=re.DOTALL)
    names: dict[str, str] = {}

    def rename(match: re.Match[str]) -> str:
        return match[1] + names.setdefault(match[2], f"{prefix}{len(names)}")

    svg = re.sub(r'(\bid="|href="#|url\(#)([^")]+)', rename, svg)
    return svg.replace("<svg ", '<svg role="img" ', 1)


def picture(drawn: Drawing | Missing, prefix: str, caption: str, on_first_screen: bool = False) -> str:
    """Figure with its caption, or a sentence with the reason why there is none.

    Args:
        prefix: As of `inline_svg`.
        on_first_screen: Whether it is made so small that it is seen without scrolling, if it is wider than high.
    """
    if isinstance(drawn, Missing):
        return paragraph(f"{drawn.reason[:1].upper()}{drawn.reason[1:]}.")
    values = safe(drawn.hover)
    svg = inline_svg(drawn, prefix)
    ratio = _ratio(svg)
    size = ' class="tall"' if ratio < 1 else f' class="first" style="--ratio: {ratio:.3f}"' * on_first_screen
    return f'<figure{size} data-hover="{values}">{svg}<figcaption>{safe(caption)}</figcaption></figure>'


def _ratio(svg: str) -> float:
    """Width of a figure divided by its height; that of a wide one if it is not known."""
    box = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg)
    return float(box[1]) / float(box[2]) if box else 2.0


def paragraph(text: str) -> str:
    """HTML paragraph."""
    return f"<p>{safe(text)}</p>"


def absence(part: str, missing: Missing) -> str:
    """HTML paragraph with the reason why a part is missing."""
    return paragraph(f"There is no {part}: {missing.reason}.")


def bullets(lines: Sequence[str]) -> str:
    """HTML list; empty for no lines."""
    return f"<ul>{''.join(f'<li>{safe(line)}</li>' for line in lines)}</ul>" if lines else ""


def table(
    caption: str, heads: Sequence[str], rows: Sequence[Sequence[str]], links: Mapping[str, str] = NO_LINKS
) -> str:
    """HTML table; the first cell of each row is its header, and a link if `links` has a relative path for it."""
    top = "".join(f'<th scope="col">{safe(head)}</th>' for head in heads)
    lines = [
        f'<tr><th scope="row">{_linked(first, links)}</th>{"".join(f"<td>{safe(cell)}</td>" for cell in cells)}</tr>'
        for first, *cells in rows
    ]
    title = f"<caption>{safe(caption)}</caption>" if caption else ""
    return (
        f'<div class="wide"><table>{title}<thead><tr>{top}</tr></thead><tbody>\n'
        + "\n".join(lines)
        + "\n</tbody></table></div>"
    )


def _linked(text: str, links: Mapping[str, str]) -> str:
    return f'<a href="{safe(links[text])}">{safe(text)}</a>' if text in links else safe(text)
