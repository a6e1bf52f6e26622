"""The files of a run, with links to them: the page lies beside them."""

from typing import Final
from urllib.parse import quote

from stepgap.records.run_folder import RunRecord
from stepgap.report.html import paragraph, table

CONTENT: Final = {
    "steps.csv": "one row for each step: state, command, next state, prediction",
    "summary.json": "errors of each deployment, noise floor, versions",
    "experiment.toml": "all settings, to repeat the experiment",
    "models/*.json": "residual at the start of a deployment",
    "figures/*.pdf": "figure of this page",
    "replay/*.npz": "motion in a deployment",
    "ticks/*.mcap": "ticks of a deployment",
}
"""Files of a run folder, by pattern, with their content."""


def file_list(record: RunRecord) -> str:
    """Table of the files in the run folder, each with a relative link."""
    found = [
        (path.relative_to(record.folder).as_posix(), content)
        for pattern, content in CONTENT.items()
        for path in sorted(record.folder.glob(pattern))
        if path.is_file()
    ]
    links = {name: quote(name) for name, _ in found}
    note = paragraph("The links lead to files beside this page, in the folder of the run.")
    rows = table("", ["file", "content"], [list(each) for each in found], links)
    return f'{note}<div class="left">{rows}</div>'
