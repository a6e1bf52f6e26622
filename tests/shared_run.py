"""A run folder of the twin that tests of report and view share; they only read it."""

from pathlib import Path

import pytest

from stepgap.cli.app import main
from tests.quick_runs import leave_out_figures, leave_out_repeats

TARGETS = "speed,height\n0.1,0.56\n0.2,0.58\n0.2,0.58\n0.15,0.57\n"
STEPS = 4


def run_into(folder: Path, *more: str) -> None:
    folder.parent.mkdir(parents=True, exist_ok=True)
    targets = folder.parent / "targets.csv"
    targets.write_text(TARGETS)
    main(["run", "--reference", str(targets), "--out", str(folder), "--seed", "5", "--iterations", "1", *more])


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two deployments of four steps on the twin, whose report is without figures."""
    folder = tmp_path_factory.mktemp("viewed") / "run"
    with pytest.MonkeyPatch.context() as patch:
        leave_out_repeats(patch)
        leave_out_figures(patch)
        run_into(folder, "--quiet")
    return folder
