"""The FMU, checked and simulated by FMPy, around a controller whose answers are known.

The controller of these tests counts the steps that its filter has learned from, and answers with sums of what it is
given, so each number shows what the unit handed to it. That of a run is tested in `test_exported_fmu.py`.
"""

import ctypes
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stepgap.base.errors import InputError
from stepgap.export.controller.fmu import COMPILERS, fmu_file
from tests.export.controller.learned import SPACE

fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
pytestmark = pytest.mark.skipif(not any(map(shutil.which, COMPILERS)), reason="there is no C compiler")

HEADER = """
typedef struct { double learned, total, yaw; } controller_filter;
void controller_filter_init(controller_filter *f);
int controller_filter_update(controller_filter *f, const double *state, const double *command, const double *next,
                             double yaw);
int controller_plan(const controller_filter *f, const double *state, const double *target, const double *guess,
                    double yaw, double *command, double *predicted, double *std);
"""
SOURCE = """
#include "controller.h"
void controller_filter_init(controller_filter *f) { f->learned = f->total = f->yaw = 0; }
int controller_filter_update(controller_filter *f, const double *state, const double *command, const double *next,
                             double yaw)
{
    f->learned += 1;
    f->total += next[0] - state[0] + command[1];
    f->yaw = yaw < 1e6 ? yaw : -1;
    return 0;
}
int controller_plan(const controller_filter *f, const double *state, const double *target, const double *guess,
                    double yaw, double *command, double *predicted, double *std)
{
    command[0] = target[0] - state[0];
    command[1] = (guess ? guess[1] : 0) + 1; /* there is no command before the first step */
    predicted[0] = f->total;
    predicted[1] = yaw < 1e6 ? yaw : -1;
    std[0] = f->learned;
    std[1] = f->yaw;
    return state[0] > 5 ? 3 : 0;
}
"""


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> str:
    file = tmp_path_factory.mktemp("fmu") / "controller.fmu"
    file.write_bytes(fmu_file(SPACE, {"controller.h": HEADER, "controller.c": SOURCE}))
    return str(file)


def opened(fmu: str, folder: Path) -> Any:
    """An instance of the unit, ready for its first step."""
    description = fmpy.read_model_description(fmu)
    if not folder.exists() or not any(folder.iterdir()):
        fmpy.extract(fmu, str(folder))
    unit = fmpy.instantiate_fmu(str(folder), description, "CoSimulation")
    begin(unit)
    return unit


def begin(unit: Any) -> None:
    unit.enterInitializationMode()
    unit.exitInitializationMode()


def take_step(unit: Any, number: int, state: float, target: float) -> list[float]:
    """The reals that the unit gives out for a step."""
    unit.setFloat64([0, 2], [state, target])
    unit.doStep(float(number), 1.0)
    return list(unit.getFloat64(list(range(5, 11))))


def close(unit: Any) -> None:
    unit.terminate()
    unit.freeInstance()


def test_it_is_valid(fmu: str) -> None:
    from fmpy.validation import validate_fmu

    assert validate_fmu(fmu) == []
    units = {each.name: each.unit for each in fmpy.read_model_description(fmu).modelVariables}
    assert (units["state_speed"], units["command_fx"], units["phase"]) == ("m/s", "N", "rad")


def test_it_is_simulated_twice_in_a_row(fmu: str) -> None:
    signals = np.array(
        [(k, 0.1 * k, 1.0, 0.5 * k) for k in range(7)],
        dtype=[("time", float), ("state_speed", float), ("target_speed", float), ("phase", float)],
    )
    options: dict[str, Any] = {
        "input": signals, "stop_time": 6.0, "step_size": 1.0, "output_interval": 1.0,
        "output": ["command_fx", "command_fy", "predicted_speed", "predicted_height", "std_speed", "std_height"],
    }  # fmt: skip
    found = [fmpy.simulate_fmu(fmu, start_values={"phase_known": True}, **options) for _ in range(2)]
    assert np.array_equal(found[0], found[1])
    last = found[0][-1]  # after the step from 5 s to 6 s, the sixth
    assert last["command_fx"] == pytest.approx(0.5)
    assert (last["command_fy"], last["std_speed"]) == (6, 5)
    assert last["predicted_speed"] == pytest.approx(5 * 0.1 + 1 + 2 + 3 + 4 + 5)
    assert (last["predicted_height"], last["std_height"]) == pytest.approx((2.5, 2.0))
    unknown = fmpy.simulate_fmu(fmu, **options)[-1]
    assert (unknown["predicted_height"], unknown["std_height"]) == (-1, -1)


def test_two_instances_do_not_disturb_each_other_and_reset_begins_again(fmu: str, tmp_path: Path) -> None:
    one, other = opened(fmu, tmp_path / "one"), opened(fmu, tmp_path / "one")
    alone = [take_step(one, k, 0.1 * k, 0.3) for k in range(4)]
    one.reset()
    begin(one)
    mixed = []
    for k in range(4):
        mixed.append(take_step(one, k, 0.1 * k, 0.3))
        take_step(other, k, 0.7 * k, 0.9)
    assert mixed == alone
    close(one)
    assert take_step(other, 4, 0.0, 0.0)[4] == 4
    close(other)


def test_a_state_is_kept_and_set_again(fmu: str, tmp_path: Path) -> None:
    unit = opened(fmu, tmp_path)
    take_step(unit, 0, 0.1, 0.2)
    kept = unit.getFMUState()
    text = unit.serializeFMUState(kept)
    first = [take_step(unit, k, 0.2 * k, 0.3) for k in (1, 2)]
    restored = unit.deserializeFMUState(text)
    unit.setFMUState(restored)
    assert [take_step(unit, k, 0.2 * k, 0.3) for k in (1, 2)] == first
    for state in (kept, restored):
        unit.freeFMUState(state)
    close(unit)


def test_a_step_that_was_not_completed_is_not_learned(fmu: str, tmp_path: Path) -> None:
    unit = opened(fmu, tmp_path)
    take_step(unit, 0, 0.1, 0.2)
    unit.setBoolean([12], [False])
    assert take_step(unit, 1, 0.1, 0.2)[4] == 0
    unit.setBoolean([12], [True])
    assert take_step(unit, 2, 0.1, 0.2)[4] == 1
    assert take_step(unit, 3, 6.0, 0.2)[2:] == [0, 0, 0, 0], "nothing is predicted"
    assert unit.getInt32([11]) == [3]
    close(unit)


def test_outputs_and_unknown_variables_cannot_be_set(fmu: str, tmp_path: Path) -> None:
    unit = opened(fmu, tmp_path)
    for reference in (5, 99):
        with pytest.raises(Exception, match="failed with status 3"):
            unit.setFloat64([reference], [1.0])
    close(unit)


def test_only_functions_of_the_standard_are_visible(fmu: str, tmp_path: Path) -> None:
    folder = Path(fmpy.extract(fmu, str(tmp_path)))
    (binary,) = (file for file in (folder / "binaries").rglob("*") if file.is_file())
    library = ctypes.CDLL(str(binary))
    assert hasattr(library, "fmi3DoStep")
    assert not hasattr(library, "controller_plan")


def test_without_a_compiler_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(InputError, match="needs a C compiler, one of cc, gcc, clang"):
        fmu_file(SPACE, {"controller.h": HEADER, "controller.c": SOURCE})


def test_a_source_that_does_not_compile_is_one_line() -> None:
    with pytest.raises(InputError, match=r"failed: .*error") as caught:
        fmu_file(SPACE, {"controller.h": HEADER, "controller.c": "int x = ;"})
    assert "\n" not in str(caught.value)
