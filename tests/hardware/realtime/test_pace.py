"""Requests for real-time execution, in processes of their own since they cannot be taken back."""

import os
import subprocess
import sys
from itertools import count
from pathlib import Path

import pytest

from stepgap.hardware.realtime.pace import WallClock, isolated_cores

ASK = """
import os, sys
from pathlib import Path
from stepgap.hardware.realtime.pace import ask_for_realtime

refused = ask_for_realtime(Path(sys.argv[1]), Path(sys.argv[2]))
print(*os.sched_getaffinity(0), "|", "; ".join(refused))
"""


def ask(isolated: Path, latency: Path) -> tuple[str, str]:
    """Cores on which a process runs after its requests, and the refused ones."""
    done = subprocess.run(
        [sys.executable, "-c", ASK, isolated, latency], capture_output=True, text=True, check=True, timeout=120
    )
    cores, refused = done.stdout.split("|")
    return cores.strip(), refused.strip()


@pytest.mark.parametrize(
    ("text", "cores"), [("", set()), ("\n", set()), ("3\n", {3}), ("2-4,7,9-9\n", {2, 3, 4, 7, 9})]
)
def test_lists_of_cores(text: str, cores: set[int]) -> None:
    assert isolated_cores(text) == cores


@pytest.mark.skipif(sys.platform != "linux", reason="cores and sleep states are requested as on Linux")
def test_the_isolated_core_and_a_processor_that_does_not_sleep(tmp_path: Path) -> None:
    isolated, latency, allowed = tmp_path / "isolated", tmp_path / "latency", sorted(os.sched_getaffinity(0))
    isolated.write_text(f"{allowed[0]}\n")
    latency.write_text("")
    cores, refused = ask(isolated, latency)
    assert cores == str(allowed[0])
    assert "core" not in refused.replace("processor", "")
    assert latency.read_bytes() == bytes(4)
    missing = next(core for core in count() if not Path(f"/sys/devices/system/cpu/cpu{core}").exists())
    isolated.write_text(f"{missing}\n")
    latency.unlink()
    latency.mkdir()  # cannot be written, also not by root
    cores, refused = ask(isolated, latency)
    assert cores == " ".join(map(str, allowed))
    assert f"the isolated core {missing} is refused: " in refused
    assert f"a processor without sleep states is refused: {latency}: " in refused


def test_a_computer_without_them_is_no_refusal(tmp_path: Path) -> None:
    _, refused = ask(tmp_path / "none", tmp_path / "none")
    assert "isolated" not in refused
    assert "sleep states" not in refused


def test_a_past_time_is_not_waited_for() -> None:
    pace = WallClock()
    assert pace(-1.0) < pace(0.001)
    assert pace(0.0) >= 0.001
