"""Makes the notebook of a page: its text in Markdown cells, its Python blocks in cells of code.

python docs/notebook.py docs/tutorial.md examples/notebooks/tutorial.ipynb
"""

import json
import re
import sys
from pathlib import Path
from typing import Any


def notebook_of(page: str) -> str:
    """The notebook, in nbformat 4.5, of the text of a page."""
    parts = re.split(r"```python\n(.*?)```\n", page, flags=re.DOTALL)
    cells = [_cell(number, text.strip()) for number, text in enumerate(parts) if text.strip()]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    content = {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(content, ensure_ascii=False, indent=1) + "\n"


def _cell(number: int, text: str) -> dict[str, Any]:
    """A cell: odd parts of a page are code. Links lead to the site's pages beside the notebook's folder."""
    code = number % 2 == 1
    if not code:
        text = re.sub(r"\]\(([a-z_]+\.(?:md|png)[^)]*)\)", r"](../../docs/\1)", text)
    cell: dict[str, Any] = {"cell_type": "code" if code else "markdown", "id": f"cell-{number}", "metadata": {}}
    if code:
        cell |= {"execution_count": None, "outputs": []}
    return cell | {"source": text.splitlines(keepends=True)}


if __name__ == "__main__":
    source, target = map(Path, sys.argv[1:])
    target.write_text(notebook_of(source.read_text("utf-8")), "utf-8")
