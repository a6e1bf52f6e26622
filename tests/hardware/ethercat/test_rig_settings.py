"""rig.toml: read strictly, with errors that state what is valid."""

import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from stepgap.base.errors import InputError
from stepgap.base.settings_file import to_table
from stepgap.hardware.hopper.ethercat import RigSettings, hopper_on_ethercat, read_rig_settings
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.step import StepStatus

EXAMPLE = Path(__file__).parents[3] / "examples" / "rig.toml"
TEXT = EXAMPLE.read_text(encoding="utf-8")
ROBOT = RobotParameters()


def read(tmp_path: Path, text: str) -> RigSettings:
    path = tmp_path / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return read_rig_settings(path)


def test_the_example_is_a_rig() -> None:
    settings = read_rig_settings(EXAMPLE)
    assert [slave.name for slave in settings.slaves][2:4] == ["coupler", "yaw encoder"]
    assert settings.motor_2.sign == -1
    assert type(settings.motor_1.counts_per_turn) is float
    assert settings.limits.torque_step == 20
    assert settings.position(settings.contact.slave) == 5
    assert settings.pdo_set(settings.slaves[5]).inputs[0].index == 0x1A00


def test_the_commented_keys_of_the_example_are_right(tmp_path: Path) -> None:
    """All of them: the set of PDOs, and the limits of what its drive reports."""
    commented = [line[2:] for line in TEXT.splitlines() if re.match(r"# (\[\[|[a-z_]+ = |  ?\")", line)]
    start = commented.index("temperature_unit = 0.1       # of one count [°C]")
    assert len(commented) == 18
    text = TEXT.replace('pdos = "elmo-cst"', 'pdos = "watched-drive"', 1)
    text = text.replace("[dc]  ", "\n".join(commented[:start]) + "\n[dc]  ")
    settings = read(tmp_path, text.replace("[motor_2]", "\n".join(commented[start:]) + "\n[motor_2]"))
    assert settings.motor_1.bus_voltage == (40.0, 56.0)
    assert settings.motor_1.sto_bits == (16, 17)
    assert settings.motor_2.sto_bits == ()
    units = hopper_on_ethercat(settings, ROBOT).diagnostic_units
    assert [name for name, unit in units.items() if unit in ("°C", "V")] == [
        "motor_1_temperature",
        "motor_1_bus_voltage",
    ]
    assert "motor_1_enable" in units


WRONG = [
    ('interface = "eth0"', "", "interface: missing; it must be given"),
    ('interface = "eth0"', 'interface = "xxxxxxxxxxxxxxxx"', "but it must name a network interface, such as 'eth0'"),
    ('interface = "eth0"', 'interface = "e\\u0000"', "but it must name a network interface, such as 'eth0'"),
    ("rated_torque = 12.0", "rated_torque = 1e300", "[motor_1] rated_torque = 1e+300, but it must lie in the range"),
    ("counts_per_turn = 5000", "counts_per_turn = 1e-300", "[boom_horizontal] counts_per_turn = 1e-300, but it must"),
    ("[[pdo_sets]]", '[[pdo_sets]]\nname = "foot-force"\n[[pdo_sets]]', "pdo_sets = ['foot-force', 'foot-force'], but"),
    ("tick = 0.001", "tick = nan", "tick = nan, but it must be a number"),
    (
        "product = 0x044C2C52",
        "product = 1\nassign_activate = 0x0100",
        "[slaves 3] assign_activate = 256, but it must be 0x0300",
    ),
    (
        "product = 0x044C2C52",
        "product = 1\nassign_activate = 0x300\nsync0_shift = 0.2",
        "[slaves 3] sync0_shift = 0.2, but it must lie between dc.window = 0.25 and 0.75",
    ),
    ('name = "right drive"', 'name = "left drive"', "slaves = ['left drive', 'left drive', "),
    ('pdos = "beckhoff-el5101"', 'pdos = "el5101"', "[slaves 4] pdos = 'el5101', but it must be one of none, elmo-cst"),
    ('pdos = "beckhoff-el5101"', "", "[boom_horizontal] slave = 'yaw encoder', but it must be a slave whose PDOs have"),
    ('name = "foot-force"', 'name = "elmo-cst"', "[pdo_sets 1] name = 'elmo-cst', but it must differ from the"),
    ("0x6000:11:16 force", "0x6000:11:12 force", "[pdo_sets 1.inputs 1] entries = '0x6000:11:12 force', but it must"),
    ("0x6000:11:16 force", "6000 force", "'6000 force' is not an entry; write it as '0x6041:00:16 statusword'"),
    ('"0x0000:00:16"', '"0x0000:00:3"', "[pdo_sets 1] name = 'foot-force', but it must be a set of PDOs: 0x6000:11:16"),
    ("sign = -1", "sign = 0", "[motor_2] sign = 0, but it must be 1 or -1"),
    (
        "torque_limit = 38.0",
        "torque_limit = 38.0\ntemperature_warning = 60\ntemperature_limit = 70",
        "[motor_1] temperature_warning = 60.0, but it must be left out, or the PDOs of 'left drive' must have an entry",
    ),
    (
        "torque_limit = 38.0",
        "torque_limit = 38.0\ntemperature_limit = 70",
        "[motor_1] temperature_warning = inf, but it must be below temperature_limit = 70",
    ),
    (
        "torque_limit = 38.0",
        "torque_limit = 38.0\nbus_voltage = [60, 20]",
        "[motor_1] bus_voltage = [60.0, 20.0], but it must be two voltages, [lowest, highest]",
    ),
    (
        'slave = "right drive"',
        'slave = "left drive"',
        "[motor_2] slave = 'left drive', but it must differ from motor 1",
    ),
    (
        'slave = "right drive"',
        'slave = "coupler"',
        "[motor_2] slave = 'coupler', but it must be a slave whose PDOs have",
    ),
    ('slave = "right drive"', 'slave = "x"', "[motor_2] slave = 'x', but it must name one of the slaves: left drive"),
    (
        "counts_per_turn = 16384",
        "counts_per_turn = 8192",
        "[motor_2] counts_per_turn = 16384.0, but it must give with its",
    ),
    (
        "newton_per_count = 0.01",
        "newton_per_count = 0",
        "[contact] newton_per_count = 0.0, but it must be finite and not",
    ),
    ("[limits]", "[", "not TOML"),
]


@pytest.mark.parametrize(("good", "bad", "expected"), WRONG, ids=lambda text: text[:30])
def test_the_error_of_a_wrong_file_states_what_is_valid(tmp_path: Path, good: str, bad: str, expected: str) -> None:
    at = "\n" + good if f"\n{good}" in TEXT else good
    assert at in TEXT
    with pytest.raises(InputError) as caught:
        read(tmp_path, TEXT.replace(at, at.replace(good, bad), 1))
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'rig.toml'}: ")
    assert expected in message
    assert "\n" not in message


def lines_with_numbers() -> list[int]:
    return [at for at, line in enumerate(TEXT.splitlines()) if " = " in line and '"' not in line]


@given(
    at=st.sampled_from(lines_with_numbers()),
    value=st.one_of(
        st.floats().map(str), st.integers().map(str), st.booleans().map(lambda yes: str(yes).lower()), st.just("[]")
    ),
)
def test_any_number_is_accepted_or_refused_in_one_line(tmp_path_factory: pytest.TempPathFactory, at: int, value: str):
    lines = TEXT.splitlines()
    key = lines[at].partition(" = ")[0]
    lines[at] = f"{key} = {value}"
    try:
        settings = read(tmp_path_factory.getbasetemp(), "\n".join(lines))
    except InputError as error:
        message = str(error)
    else:
        message = key
        assert 0 < settings.limits.torque < float("inf")
        trial = RealtimeSetup(
            partial(hopper_on_ethercat, settings, ROBOT), HopperControl(ROBOT, Gains(), CommandBounds())
        )
        assert trial.robot_control.control(trial.make_rig()).status == StepStatus.OK
        assert 0 <= settings.motor_1.most_units <= 32000
        assert settings.motor_1.most_units * settings.motor_1.torque_unit <= settings.motor_1.torque_limit * (1 + 1e-15)
    # a number may be refused by the key that it contradicts, such as torque_limit by a small rated_torque
    assert key in message or "rig.toml: [" in message
    assert "\n" not in message


def test_written_settings_are_read_back(tmp_path: Path) -> None:
    for settings in (read_rig_settings(EXAMPLE), replace(read_rig_settings(EXAMPLE), pivot_height=1.0)):
        assert read(tmp_path, tomli_w.dumps(to_table(settings))) == settings
