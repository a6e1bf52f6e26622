"""MkDocs hook: pages keep their paths of the repository, so a link that works there works on the site.

A line that is a link with the title "included" gives way to the section it leads to: each sentence stands in one place.
"""

import posixpath
import re
from pathlib import Path

from markdown.extensions.toc import slugify
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parent.parent
HOME = "docs/index.md"
"""It includes what is needed of README.md, so links to the one lead to the other."""
ROOT_PAGES = ("ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md", "NOTATION.md", "SECURITY.md")
LINK = re.compile(r"(!?\[[^]]*\])\(([^):# ]+)(#[^) ]+)?\)")
INCLUDED = re.compile(r'^\[.*\]\((\S+)#(\S+) "included"\)$', re.MULTILINE)
HEADING = re.compile(r"^(?=#+ )", re.MULTILINE)
FETCHED = re.compile(
    r'<(?:script|link(?! rel="?canonical)|img|iframe|source)\b[^>]*(?:src|href)="?(?:https?:)?//[^>]*>'
)
"""What a browser fetches from another machine. A canonical link, the page's own address, is not fetched."""


def on_files(files: Files, *, config) -> Files:
    """The pages, and what they link to: program texts become texts that a browser shows."""
    own = [file for file in files if file.src_dir == config.docs_dir]
    destinations = {f"docs/{file.src_uri}": file.dest_uri for file in own if not file.inclusion.is_excluded()}
    destinations |= {name: f"{name.removesuffix('.md').lower()}/index.html" for name in ROOT_PAGES}
    for page in [name for name in destinations if name.endswith(".md")]:
        for target in (at(page, link[2]) for link in LINK.finditer(text_of(page))):
            if (ROOT / target).is_file() and not target.endswith((".md", ".png")):
                destinations[target] = f"{target}.txt"
    from_root = [
        File(name, str(ROOT), config.site_dir, config.use_directory_urls, dest_uri=destination)
        for name, destination in destinations.items()
    ]
    return Files([*(file for file in files if file not in own), *from_root])


def on_page_markdown(markdown: str, *, page, **_) -> str:
    """The text of a page, its links led to where things are on the site."""
    name = page.file.src_uri

    def led(link: re.Match[str]) -> str:
        target = at(name, link[2])
        if (ROOT / target).is_dir():
            return link[1][1:-1]  # a site has no folders to look into: only the words stay
        return f"{link[1]}({seen_from(name, HOME if target == 'README.md' else target)}{link[3] or ''})"

    return LINK.sub(led, text_of(name))


def on_post_page(output: str, *, page, **_) -> str:
    """Refuses what would ask another machine when the page is opened."""
    if found := FETCHED.search(output):
        raise PluginError(f"{page.file.src_uri} fetches from elsewhere: {found[0]}")
    return output


def text_of(page: str) -> str:
    """Text of a page, with what it includes."""
    return INCLUDED.sub(lambda found: section(at(page, found[1]), found[2], page), (ROOT / page).read_text("utf-8"))


def section(source: str, slug: str, page: str) -> str:
    """What stands in `source` under the heading of this anchor, up to the next heading, as if it stood in `page`."""
    for part in HEADING.split((ROOT / source).read_text("utf-8")):
        if slugify(part.partition("\n")[0].lstrip("# "), "-") == slug:
            if part.count("```") % 2:
                raise PluginError(f"{page} includes {source}#{slug}, whose code has a line like a heading")
            return LINK.sub(lambda link: f"{link[1]}({seen_from(page, at(source, link[2]))}{link[3] or ''})", part)
    raise PluginError(f"{page} includes {source}#{slug}, which is not there")


def at(page: str, target: str) -> str:
    """Path in the repository of what a page links to."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(page), target))


def seen_from(page: str, target: str) -> str:
    """The link in a page to a path in the repository."""
    return posixpath.relpath(target, posixpath.dirname(page) or ".")
