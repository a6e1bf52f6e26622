"""A figure that cannot be drawn is replaced by the reason."""

import builtins
import os
import subprocess
import sys
from pathlib import Path

import pytest

from stepgap.records.missing import Missing
from stepgap.report.drawing import LONGEST_ERROR, draw_figure
from tests.report.pages import Page, check_alone
from tests.report.runs import report_of, write_run


@pytest.mark.usefixtures("made_figures")
def test_the_reason_is_one_short_line() -> None:
    def fail() -> None:
        raise OSError("no font\n" * 100)

    missing = draw_figure(fail, "errors")
    assert isinstance(missing, Missing)
    assert missing.reason.startswith("no figure of errors could be drawn (OSError: no font no font")
    assert "pip install --force-reinstall matplotlib" in missing.reason
    assert len(missing.reason) < 250 + LONGEST_ERROR


@pytest.mark.usefixtures("made_figures")
def test_a_report_needs_no_matplotlib(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    imported = builtins.__import__

    def without(name: str, *rest: object, **named: object) -> object:
        if name.startswith(("matplotlib", "stepgap.report.state_figure")):
            raise ImportError("libfreetype.so.6: cannot open shared object file")
        return imported(name, *rest, **named)  # pyright: ignore[reportArgumentType]

    folder = write_run(tmp_path / "run", ("x",), steps=3)
    monkeypatch.setattr(builtins, "__import__", without)
    page = Page(report_of(folder))
    check_alone(page, 0)
    assert page.text.count("could be drawn (ImportError: libfreetype.so.6") == 5
    assert not (folder / "figures").exists()


@pytest.mark.parametrize("comment", [b"", "# Größe\n".encode("latin-1")])
def test_the_settings_of_the_user_do_not_count(comment: bytes, tmp_path: Path) -> None:
    """A new process: with a backend that is not installed, or another encoding, Matplotlib cannot be imported."""
    settings = b"text.usetex: True\nfont.size: 30\naxes.facecolor: red\n"
    (tmp_path / "matplotlibrc").write_bytes(comment + settings)
    users = {"MPLBACKEND": "module://not_installed.backend_inline", "MATPLOTLIBRC": str(tmp_path / "matplotlibrc")}
    program = (
        "import os, sys\n"
        "from stepgap.report.drawing import draw_figure\n"
        "def make():\n"
        "    from matplotlib.backends.backend_agg import FigureCanvasAgg\n"
        "    from matplotlib.figure import Figure\n"
        "    figure = Figure(figsize=(1, 1))\n"
        "    FigureCanvasAgg(figure)\n"
        "    figure.text(0, 0, 'a_b')\n"
        "    return figure\n"
        "sys.stdout.buffer.write(draw_figure(make, 'it').saved('png'))\n"
        "import matplotlib\n"
        "sys.stderr.write(os.environ.get('MPLBACKEND', '') + matplotlib.rcParams['backend'])\n"
    )

    def drawn(environment: dict[str, str]) -> subprocess.CompletedProcess[bytes]:
        return subprocess.run(
            [sys.executable, "-c", program], env=os.environ | environment, capture_output=True, check=True
        )

    own, default = drawn(users), drawn({})
    assert own.stdout == default.stdout
    assert own.stdout.startswith(b"\x89PNG")
    assert own.stderr.decode().endswith(2 * users["MPLBACKEND"]), "pyplot has the user's backend"


VERBS = (
    "report.cli.gait",
    "report.cli.report",
    "logs.cli.fit",
    "logs.cli.steps",
    "hardware.cli.rig",
    "sweep.report.page",
)


def test_matplotlib_is_imported_with_own_settings_only() -> None:
    """So no verb imports it before `own_style`."""
    imports = "; ".join(f"import stepgap.{module}" for module in VERBS)
    program = f"import sys; {imports}; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
