"""`stepgap export`, `recover` and `doctor`: their output agrees with the record, and bad input does no harm."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

import csv
import json
import math
import shutil
import sys
import tomllib
from collections.abc import Callable
from importlib.metadata import metadata
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.io import loadmat

from stepgap.cli.app import main
from stepgap.cli.doctor import _packages_of, doctor
from stepgap.experiment.replay import replay
from stepgap.experiment.run import Run, load_run
from stepgap.export.controller.model_reading import read_portable
from stepgap.learning.steps import Steps
from stepgap.plants.ticks.tick_log import TickLog, read_ticks
from stepgap.records.steps_csv import read_step_log
from stepgap.records.summary import NoiseFloor
from stepgap.robots.hopper.parameters import CommandBounds
from stepgap.robots.hopper.tick.tick_row import TICK_UNITS
from tests.cli.command_line import Command, CommandResult, refused
from tests.full_disk import FILE_TOO_LARGE, largest_file
from tests.quick_runs import leave_out_report
from tests.report.runs import make_run

SPACE = CommandBounds().space()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run of two deployments of three steps."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "targets.csv").write_text("speed,height\n0.1,0.56\n0.2,0.58\n0.2,0.58\n")
    with pytest.MonkeyPatch.context() as patch:
        leave_out_report(patch)
        floor = NoiseFloor(np.array([0.01, np.nan]), np.array([0.01, np.nan]))
        patch.setattr("stepgap.experiment.plants.measure_noise_floor", lambda *_, **__: floor)
        paths = ["--reference", str(folder / "targets.csv"), "--out", str(folder / "run")]
        main(["run", *paths, "--iterations", "1", "--seed", "5", "--quiet"])
    return folder / "run"


@pytest.fixture
def run(made: Path, stepgap: Command) -> Path:
    return Path(shutil.copytree(made, "run"))


@pytest.fixture
def log(made: Path) -> Steps:
    return read_step_log(made / "steps.csv", SPACE)


def contents(folder: Path = Path()) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


# Steps


def test_matlab_gets_structs_of_columns(run: Path, stepgap: Command, log: Steps) -> None:
    assert stepgap("export", run, "--to", "mat") == CommandResult(0, "run/export/run.mat\n", "")
    file = loadmat("run/export/run.mat", simplify_cells=True)
    steps, summary = file["steps"], file["summary"]
    assert list(steps) == (run / "steps.csv").read_text().splitlines()[0].split(",")
    np.testing.assert_array_equal(np.stack([steps["speed"], steps["height"]], axis=1), log.state)
    np.testing.assert_array_equal(np.stack([steps["applied_fx"], steps["applied_fy"]], axis=1), log.applied)
    assert steps["status"].tolist() == 8 * ["ok"]
    assert steps["iteration"].tolist() == 4 * [0] + 4 * [1]
    assert file["units"]["next_speed"] == "m/s"
    assert (file["units"]["applied_fx"], len(file["units"]["step"])) == ("N", 0)
    wanted = tomllib.loads((run / "experiment.toml").read_text())
    assert file["settings"]["gains"] == pytest.approx(wanted["gains"])
    assert (file["settings"]["seed"], file["settings"]["learning"]["residual"]) == (5, "posterior")
    known = json.loads((run / "summary.json").read_text())
    assert summary["rmse"]["speed"].tolist() == [entry["rmse"]["speed"] for entry in known["iterations"]]
    assert summary["residual"].tolist() == ["none", "posterior"]
    assert (summary["repeatability"]["speed"], math.isnan(summary["repeatability"]["height"])) == (0.01, True)
    columns = loadmat("run/export/run.mat")["steps"]["speed"][0, 0]
    assert columns.shape == (8, 1), "columns, as in MATLAB"


def test_a_run_of_another_robot_that_is_not_finished(stepgap: Command) -> None:
    make_run(Path("other"), iterations=1)
    Path("other/summary.json").unlink()
    Path("other/experiment.toml").write_text(f"a-b = 1\nlong = 1{'0' * 400}\n")
    refused(stepgap("export", "other", "--to", "mat"), "'a-b': not a valid name in MATLAB; export to csv instead")
    Path("other/experiment.toml").write_text(f"[[list]]\nb = 1\n[c]\nlong = 1{'0' * 400}\nyes = true\n")
    assert stepgap("export", "other", "--to", "mat").code == 0
    file = loadmat("other/export/run.mat", simplify_cells=True)
    assert file["settings"]["list"]["b"] == 1
    assert (file["settings"]["c"]["yes"], len(file["settings"]["c"]["long"])) == (1, 401)
    assert file["summary"]["rmse"]["speed"].size == 0
    assert len(file["steps"]["speed"]) == 80
    assert stepgap("export", "other", "--to", "csv").code == 0
    Path("other/experiment.toml").unlink()
    assert stepgap("export", "other", "--to", "mat").code == 0


def test_csv_has_a_second_table_of_units(run: Path, stepgap: Command) -> None:
    result = stepgap("export", run, "--to", "csv")
    assert result == CommandResult(0, "run/export/steps.csv\nrun/export/steps_columns.csv\n", "")
    assert Path("run/export/steps.csv").read_bytes() == (run / "steps.csv").read_bytes()
    legend = list(csv.DictReader(Path("run/export/steps_columns.csv").read_text("utf-8").splitlines()))
    assert [row["column"] for row in legend] == (run / "steps.csv").read_text().splitlines()[0].split(",")
    units = {row["column"]: row["unit"] for row in legend}
    assert [units[name] for name in ("std_speed", "target_height", "fy", "status")] == ["m/s", "m", "N", ""]
    assert all(row["meaning"] for row in legend)


def test_one_deployment_alone(run: Path, stepgap: Command) -> None:
    assert stepgap("export", run, "--to", "csv", "--iteration", 1).out.startswith("run/export/steps_1.csv\n")
    header, *rows = (run / "steps.csv").read_text().splitlines()
    assert Path("run/export/steps_1.csv").read_text().splitlines() == [header, *rows[4:]]


def test_parquet_keeps_numbers_and_units(run: Path, stepgap: Command, log: Steps) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is an extra")
    assert stepgap("export", run, "--to", "parquet").out == "run/export/steps.parquet\n"
    table = parquet.read_table("run/export/steps.parquet")
    np.testing.assert_array_equal(table["next_height"].to_numpy(), log.next_state[:, 1])
    assert table.schema.field("speed").metadata[b"unit"] == b"m/s"
    assert table["status"].to_pylist() == 8 * ["ok"]


def test_without_pyarrow_the_message_names_the_package(
    run: Path, stepgap: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    refused(stepgap("export", run, "--to", "parquet"), "pip install 'stepgap[parquet]'")
    assert not Path("run/export").exists()


# Ticks


def test_every_tick_of_a_deployment(run: Path, stepgap: Command) -> None:
    assert stepgap("export", run, "--to", "mcap") == CommandResult(0, "run/export/ticks_1.mcap\n", "")
    units, ticks = read_ticks(Path("run/export/ticks_1.mcap"))
    simulated = replay(Run(run), 1)
    assert units == simulated.units
    np.testing.assert_array_equal(ticks, simulated.rows)
    with Path("run/export/ticks_1.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(ticks), "by the library itself"
    assert stepgap("export", run, "--to", "mcap", "--deployment", 0, "--out", "a.mcap").out == "a.mcap\n"


def test_a_rigs_own_ticks_are_copied_or_recovered(run: Path, stepgap: Command) -> None:
    (run / "experiment.toml").write_text('plant = "ethercat"\n')
    ticks = np.arange(4000.0 * len(TICK_UNITS)).reshape(4000, len(TICK_UNITS)) * 1e-3
    for number in range(2):
        with TickLog(run / "ticks" / f"ticks-{number}.mcap", TICK_UNITS) as rows:
            rows.append(ticks)
    whole = (run / "ticks" / "ticks-0.mcap").read_bytes()
    (run / "ticks" / "ticks-1.mcap").write_bytes(whole[: len(whole) // 2])
    (run / "ticks" / "ticks-2.mcap").write_bytes(b"rubbish")
    before = contents(run / "ticks")
    lines = stepgap("export", run, "--to", "mcap").out.splitlines()
    assert lines[0] == "run/export/ticks/ticks-0.mcap"
    assert lines[1].startswith("run/export/ticks/ticks-1.mcap (")
    assert "ticks recovered: it is truncated" in lines[1]
    assert lines[2] == "left out: run/ticks/ticks-2.mcap: this is not an MCAP file; give a tick log"
    assert Path("run/export/ticks/ticks-0.mcap").read_bytes() == whole
    _, found = read_ticks(Path("run/export/ticks/ticks-1.mcap"))
    np.testing.assert_array_equal(found, ticks[: len(found)])
    assert len(found) > 1000
    assert contents(run / "ticks") == before
    refused(
        stepgap("export", run, "--to", "mcap", "--deployment", 0), "--deployment: not valid for the tick logs of a rig"
    )
    refused(stepgap("export", run, "--to", "mjcf"), "plant 'ethercat'")
    shutil.rmtree(run / "ticks")
    refused(stepgap("export", run, "--to", "mcap"), "run/ticks: contains no .mcap file")


def test_a_foxglove_layout_plots_every_field_of_the_log_once(run: Path, stepgap: Command) -> None:
    assert stepgap("export", run, "--to", "foxglove").out == "run/export/foxglove.json\n"
    stepgap("export", run, "--to", "mcap", "--iteration", 0)
    with Path("run/export/ticks_0.mcap").open("rb") as file:  # read by the format's own libraries
        _, channel, _, message = next(make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
    fields = {f"{channel.topic}.{field.name}" for field in message.DESCRIPTOR.fields}
    layout = json.loads(Path("run/export/foxglove.json").read_text())
    panels = layout["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel["paths"]]
    assert len(paths) == len(set(paths))
    assert set(paths) == fields - {"ticks.time"}
    assert sorted(placed(layout["layout"])) == sorted(panels)
    units = replay(Run(run), 0, 1000).units
    for panel in panels.values():
        names = [path["value"].removeprefix("ticks.") for path in panel["paths"]]
        assert {units[name] or "without unit" for name in names} == {panel["title"]}
    refused(stepgap("export", run, "--to", "foxglove", "--deployment", 0), "--deployment: the layout is the same")


def test_a_foxglove_layout_of_a_rig_is_that_of_its_log(run: Path, stepgap: Command) -> None:
    (run / "experiment.toml").write_text('plant = "ethercat"\n')
    refused(stepgap("export", run, "--to", "foxglove"), "run/ticks: contains no .mcap file")
    with TickLog(run / "ticks" / "ticks-1.mcap", {"time": "s", "torque": "N·m"}) as rows:
        rows.append(np.zeros((1, 2)))
    (run / "ticks" / "ticks-0.mcap").write_bytes(b"rubbish")
    assert stepgap("export", run, "--to", "foxglove", "--out", "a.json").code == 0
    (panel,) = json.loads(Path("a.json").read_text())["configById"].values()
    assert [path["value"] for path in panel["paths"]] == ["ticks.torque"]


def placed(area: dict[str, Any] | str) -> list[str]:
    """Names of the panels in an area of the window."""
    return [area] if isinstance(area, str) else [*placed(area["first"]), *placed(area["second"])]


# Model


def test_the_model_is_opened_by_mujoco_and_falls(run: Path, stepgap: Command) -> None:
    assert stepgap("export", run, "--to", "mjcf").out == "run/export/mjcf/hopper.xml\nrun/export/mjcf/scene.xml\n"
    for name in ("hopper.xml", "scene.xml"):
        model = mujoco.MjModel.from_xml_path(f"run/export/mjcf/{name}")
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
        height = data.qpos[1]
        mujoco.mj_step(model, data, 200)
        assert data.qpos[1] < height, "it falls, because its hip is free"
        assert np.isfinite(data.qpos).all()
    assert model.camera("side").id == 0


# Damaged records


def cut(count: int) -> Callable[[bytes], bytes]:
    return lambda content: content[:-count]


@pytest.mark.parametrize(
    ("spoil", "steps", "fault"),
    [
        (bytes, 8, ""),
        (cut(9), 7, "the last line is cut off after "),
        (cut(1), 7, "the last line is cut off after "),
        (lambda content: content + b"\0" * 4096, 8, "the last line is cut off after 4096 bytes"),
        (lambda content: content + b"\xff\xfe\n1,2\n", 8, "not text from byte "),
        (lambda content: content.replace(b"\n1,1,", b"\n1,9,"), 5, "line 7: not the next step"),
        (lambda content: content.replace(b",ok\n", b",okay\n", 3).replace(b",okay\n", b",ok\n", 2), 2, "line 4: not"),
    ],
)
def test_the_intact_steps_of_a_damaged_record(
    run: Path, stepgap: Command, log: Steps, spoil: Callable[[bytes], bytes], steps: int, fault: str
) -> None:
    broken = spoil((run / "steps.csv").read_bytes())
    (run / "steps.csv").write_bytes(broken)
    result = stepgap("recover", run / "steps.csv")
    *faults, count, path = result.out.splitlines()
    assert (result.code, result.err, path) == (0, "", "run/steps_recovered.csv")
    assert count == (f"{steps} steps recovered" if fault else "8 steps copied: the file has no fault")
    assert len(faults) == bool(fault)
    assert fault in "".join(faults)
    recovered = read_step_log(Path(path), SPACE)
    np.testing.assert_array_equal(recovered.next_state, log.next_state[:steps])
    assert (run / "steps.csv").read_bytes() == broken


def test_the_intact_ticks_of_a_damaged_log(stepgap: Command) -> None:
    ticks = np.arange(2000.0 * len(TICK_UNITS)).reshape(2000, len(TICK_UNITS)) * 1e-3
    with TickLog(Path("a.mcap"), TICK_UNITS) as rows:
        rows.append(ticks)
    whole = Path("a.mcap").read_bytes()
    Path("a.mcap").write_bytes(whole[: len(whole) // 2])
    result = stepgap("recover", "a.mcap", "--out", "b.mcap")
    assert result.out.splitlines()[0].startswith("a.mcap: it is truncated")
    _, found = read_ticks(Path("b.mcap"))
    assert result.out.splitlines()[1:] == [f"{len(found)} ticks recovered", "b.mcap"]
    np.testing.assert_array_equal(found, ticks[: len(found)])
    assert 500 < len(found) < 1500
    assert stepgap("recover", "b.mcap").out == f"{len(found)} ticks copied: the file has no fault\nb_recovered.mcap\n"


# Bad input: one line, exit code 2, no file written or changed


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ("export run", ["--to"]),
        ("export run --to xls", ["--to", "xls"]),
        ("export none --to mat", ["none/steps.csv: no such file"]),
        ("export none --to mcap", ["none/steps.csv: no such file"]),
        ("export none --to mjcf", ["none: the folder contains no experiment.toml"]),
        ("export run --to csv --iteration 2", ["--deployment 2: no step of it in the run; there are 0, 1"]),
        ("export run --to mcap --iteration 2", ["no step of deployment 2; recorded deployments: 0, 1"]),
        ("export run --to mjcf --deployment 1", ["--deployment: the model is the same in all deployments"]),
        ("export run --to csv --deployment -1", ["--deployment"]),
        ("export run --to mat --out file", ["file: exists already; choose another --out"]),
        ("export run --to mcap --out file", ["file: exists already; choose another --out"]),
        ("export run --to mjcf --out run", ["run: exists already; choose another --out"]),
        ("export run --to csv --out a.csv", ["a_columns.csv: exists already; choose another --out"]),
        ("export run --to csv --out none/a.csv", ["none/a.csv: cannot be written: no folder to write in"]),
        ("export cut --to mat", ["cut/summary.json: deployment 1 has 3 steps"]),
        ("export changed --to mcap --iteration 0", ["changed/summary.json: steps.csv was changed"]),
        ("export foreign --to mat", ["foreign/steps.csv, line 1: not the header of a step log"]),
        ("export binary --to parquet", ["binary/steps.csv"]),
        ("export unsettled --to mat", ["unsettled/experiment.toml: not TOML"]),
        ("export unsettled --to mjcf", ["unsettled/experiment.toml: not TOML"]),
        ("export nested --to mat", ["nested/experiment.toml: not TOML"]),
        ("recover none", ["none: No such file or directory"]),
        ("recover .", [".: contains no steps.csv; give the folder of a run, a steps.csv or an .mcap file"]),
        ("recover file", ["file, line 1: not the header of a step log"]),
        ("recover empty.csv", ["empty.csv: no step yet"]),
        ("recover header.csv", ["header.csv: it contains no complete step"]),
        ("recover rubbish.mcap", ["rubbish.mcap: this is not an MCAP file"]),
        ("recover magic.mcap", ["magic.mcap: it has no description of ticks"]),
        ("recover run/steps.csv --out file", ["file: exists already; choose another --out"]),
        ("doctor now", ["now"]),
    ],
)
def test_bad_input_is_refused_in_one_line(run: Path, stepgap: Command, arguments: str, parts: list[str]) -> None:
    text = (run / "steps.csv").read_text()
    for name in ("cut", "changed", "foreign", "binary", "unsettled", "nested"):
        shutil.copytree(run, name)
    Path("cut/steps.csv").write_text(text[:-9])
    Path("changed/steps.csv").write_text(text.replace("0.56", "0.57"))
    Path("foreign/steps.csv").write_text("time,speed\n0,1\n")
    Path("binary/steps.csv").write_bytes(bytes(range(256)) * 8)
    Path("unsettled/experiment.toml").write_text("[[[\n")
    Path("nested/experiment.toml").write_text(f"a = {'[' * 5000}")
    Path("file").write_text("keep me")
    Path("a_columns.csv").write_text("keep me")
    Path("empty.csv").write_bytes(b"")
    Path("header.csv").write_text(text[: text.index("\n") + 1])
    Path("rubbish.mcap").write_bytes(b"rubbish")
    Path("magic.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(1000))
    before = contents()
    refused(stepgap(*arguments.split()), *parts)
    assert contents() == before


def test_no_file_is_overwritten(run: Path, stepgap: Command) -> None:
    for name in ("run.mat", "run_2.mat"):
        assert stepgap("export", run, "--to", "mat").out == f"run/export/{name}\n"
    for name in ("mjcf", "mjcf_2"):
        assert stepgap("export", run, "--to", "mjcf").out.startswith(f"run/export/{name}/hopper.xml\n")
    for name in ("steps_recovered.csv", "steps_recovered_2.csv"):
        assert stepgap("recover", run / "steps.csv").out.endswith(f"\nrun/{name}\n")


# The machine


def test_a_full_disk_leaves_no_part_of_an_export(run: Path, stepgap: Command) -> None:
    with largest_file(1000):
        refused(stepgap("export", run, "--to", "mat", "--out", "run.mat"), "run.mat", FILE_TOO_LARGE)
        refused(stepgap("new", "jumper"), "jumper", FILE_TOO_LARGE)
    assert not Path("run.mat").exists()
    assert not Path("jumper").exists()
    assert stepgap("export", run, "--to", "mat", "--out", "run.mat").code == 0


def test_doctor_lists_the_components(stepgap: Command) -> None:
    result = stepgap("doctor")
    assert (result.code, result.err) == (0, "")
    table = dict(line.split(maxsplit=1) for line in result.out.splitlines() if not line.startswith("extra"))
    assert table["python"] == ".".join(map(str, sys.version_info[:3]))
    assert {"numpy", "mujoco", "cores", "display", "OpenGL", "raw", "real", "cache"} <= set(table)
    for extra in metadata("stepgap").get_all("Provides-Extra") or []:
        assert f"extra {extra} " in result.out, "doctor.PURPOSES names its purpose"


def test_doctor_looks_for_the_packages_of_an_extra_within_an_extra() -> None:
    first, *further = _packages_of("mujoco[sysid]; extra == 'sysid'")
    assert first == "mujoco"
    assert "plotly" in further
    assert list(_packages_of("pyarrow>=18; extra == 'parquet'")) == ["pyarrow"]
    assert list(_packages_of("no-such-package[inner]")) == ["no-such-package"]


def test_doctor_knows_a_machine_that_has_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("stepgap.cli.doctor._try", lambda *_, **__: None)
    monkeypatch.setattr("stepgap.cli.doctor._version", lambda _: None)
    monkeypatch.setattr("stepgap.base.compiled.cache_folder", lambda: None)
    monkeypatch.setattr("socket.socket", refuse)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(name, raising=False)
    doctor()
    found = capsys.readouterr().out
    for parts in (
        "none; needed only for MuJoCo's own pictures",
        "apt install libegl1",
        "EtherCAT needs",
        "the trial failed",
        "no folder can be written",
        "to install it: ./go uv pip install 'stepgap[parquet]'",
    ):
        assert parts in found


def test_what_was_learned_is_exported_for_other_programs(run: Path, stepgap: Command) -> None:
    result = stepgap("export", run, "--to", "model", "--deployment", 1)
    assert (result.code, result.out) == (0, "run/export/model_1.json\n")
    assert "nominal map → polynomial" in result.err, "what was replaced"
    found = read_portable(Path("run/export/model_1.json"))
    state, command = SPACE.state_centre, SPACE.command_centre
    assert np.abs(found.map(state, command) - load_run(run).corrected(1)(state, command)).max() < 1e-4
    document = json.loads(Path("run/export/model_1.json").read_text("utf-8"))
    assert "family" in [each["kind"] for each in document["beliefs"]["beliefs"]], "it began with a prior over robots"
    refused(stepgap("export", run, "--to", "model", "--deployment", 7), "has no deployment 7")


@pytest.mark.parametrize("name", ["onnx", "casadi"])
def test_without_its_library_an_export_says_what_to_install(
    name: str, run: Path, stepgap: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    refused(stepgap("export", run, "--to", name, "--deployment", 1), f"--to {name} needs {name}:", f"stepgap[{name}]")
    assert not list(run.glob("export/*"))


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ("none.mcap", ["none.mcap: No such file or directory"]),
        ("file", ["file: this is not an MCAP file; give a tick log"]),
        ("twin.mcap", ["twin.mcap: has no field 'state'; give a log of stepgap run or rig dry-run on a rig"]),
        ("twin.mcap --seconds -1", ["--seconds"]),
        ("twin.mcap --out a.gif", ["a.gif: the name must end with one of .pdf, .png, .svg"]),
        ("twin.mcap --out file.png", ["file.png: exists already; choose another --out"]),
    ],
)
def test_an_incident_in_something_else_is_refused(stepgap: Command, arguments: str, parts: list[str]) -> None:
    with TickLog(Path("twin.mcap"), TICK_UNITS) as log:
        log.append(np.zeros((3, len(TICK_UNITS))))
    for name in ("file", "file.png"):
        Path(name).write_text("keep me")
    before = contents()
    refused(stepgap("rig", "incident", *arguments.split()), *parts)
    assert contents() == before
