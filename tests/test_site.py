"""The site of docs/: its pages fetch nothing from another machine, as `mkdocs serve` shows them, too."""

import runpy
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
from mkdocs.commands.build import build
from mkdocs.config import load_config
from mkdocs.exceptions import PluginError

ROOT = Path(__file__).parents[1]
SERVED = "http://127.0.0.1:8000/"
"""Address of the site that `mkdocs serve` puts into its pages."""


def build_page(page: str, pages: Path, site: Path) -> str:
    """The HTML of one page of docs/, built in the configuration of `mkdocs serve` without search and API."""
    pages.mkdir()
    shutil.copy(ROOT / "docs" / page, pages)
    nav = [f"docs/{page}"]
    config = load_config(
        str(ROOT / "mkdocs.yml"), docs_dir=str(pages), site_dir=str(site), site_url=SERVED, plugins=[], nav=nav
    )
    config.plugins.on_startup(command="serve", dirty=False)
    build(config)
    return (site / Path(page).stem / "index.html").read_text("utf-8")


def test_a_served_page_names_its_own_address(tmp_path: Path) -> None:
    assert f'<link rel="canonical" href="{SERVED}glossary/">' in build_page(
        "glossary.md", tmp_path / "docs", tmp_path / "site"
    )


@pytest.mark.parametrize(
    "tag",
    [
        '<script src="https://elsewhere/x.js"></script>',
        '<link rel="stylesheet" href="//elsewhere/x.css">',
        '<link href="https://elsewhere/x.css" rel=stylesheet>',
        "<img src=http://elsewhere/x.png>",
    ],
)
def test_a_page_that_fetches_from_elsewhere_is_refused(tag: str) -> None:
    check = runpy.run_path(str(ROOT / "docs" / "site_layout.py"))["on_post_page"]
    page = SimpleNamespace(file=SimpleNamespace(src_uri="page.md"))
    with pytest.raises(PluginError, match=r"^page\.md fetches from elsewhere: <"):
        check(tag, page=page)
