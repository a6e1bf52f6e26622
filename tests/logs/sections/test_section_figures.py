"""The figure of `stepgap steps`, of a log with doubtful sections."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from stepgap.logs.sections.section_figures import SECTIONS_IN_ROW, sections_picture
from stepgap.logs.sections.section_settings import SectionSettings
from stepgap.logs.sections.step_extraction import extract_steps
from tests.logs.sections.hopping_logs import hopping, lost_rows, write


def test_every_section_is_drawn_and_each_doubtful_one_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    write(lost_rows(8, 0.3)(hopping(60, rng, 500.0), rng), tmp_path, rng)
    settings = SectionSettings(height="height", phase="phase", state=("speed=rate(forward)", "height"))
    log = extract_steps(str(tmp_path / "log.csv"), None, settings)
    drawn: list[Figure] = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda figure, *a, **k: (drawn.append(figure), save(figure, *a, **k)))
    assert sections_picture([log, log], "svg").startswith(b"<?xml")
    parts = drawn[0].subfigs
    doubtful = [time for time, doubt in zip(log.sections.time, log.sections.doubts, strict=True) if doubt]
    overviews = 2 * -(-(len(log.sections.time) - 1) // SECTIONS_IN_ROW)
    assert len(doubtful) > 0
    assert len(parts) == overviews + 2 * len(doubtful)
    shown = [
        time
        for part in parts[: overviews // 2]
        for line in part.axes[0].get_lines()
        if line.get_label() in ("section", "doubtful")
        for time in np.asarray(line.get_xdata()).tolist()
    ]
    assert set(shown) == set(log.sections.time.tolist())
    titles = [part.get_suptitle() for part in parts[overviews : overviews + len(doubtful)]]
    assert all(title.startswith(f"log.csv, {time:.3f} s: ") for title, time in zip(titles, doubtful, strict=True))
    assert [axes.get_ylabel() for axes in parts[overviews].axes[:2]] == ["height", "forward"]
