"""moteus.toml: read strictly, with errors that state what is valid."""

from math import inf, isfinite
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.base.errors import InputError
from stepgap.hardware.hopper.moteus import MoteusSettings, hopper_on_moteus, read_moteus_settings
from stepgap.hardware.moteus.moteus_settings import Controller
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.tick.sensors import hopper_sensors

EXAMPLE = Path(__file__).parents[3] / "examples" / "moteus.toml"
TEXT = EXAMPLE.read_text(encoding="utf-8")


def read(tmp_path: Path, text: str) -> MoteusSettings:
    path = tmp_path / "moteus.toml"
    path.write_text(text, encoding="utf-8")
    return read_moteus_settings(path)


def test_the_example_is_a_rig() -> None:
    settings = read_moteus_settings(EXAMPLE)
    assert (settings.motor_1.id, settings.motor_2.id, settings.motor_2.sign) == (1, 2, -1)
    assert settings.boom_vertical.id == 2
    assert settings.limits.torque_step == 20
    assert settings.contact.zero == 400


WRONG = [
    ('channel = "can0"', "", "channel: missing; it must be given"),
    ('channel = "can0"', 'chanel = "can0"', "chanel: unknown key; did you mean channel?"),
    ('channel = "can0"', 'channel = ""', "channel = '', but it must be a name, such as 'can0'"),
    ("tick = 0.002 ", "tick = nan ", "tick = nan, but it must be a number"),
    ("watchdog = 0.05 ", "watchdog = nan ", "watchdog = nan, but it must be a number"),
    ("watchdog = 0.05 ", "watchdog = 0.0 ", "watchdog = 0.0, but it must be at least two ticks, at most 0.5"),
    ("reply_timeout = 0.001 ", "reply_timeout = 0.06 ", "reply_timeout = 0.06, but it must be positive and less than"),
    ("id = 2\ntorque", "id = 1\ntorque", "[motor_2] id = 1, but it must differ from motor 1's"),
    ("id = 2\ntorque", "id = 127\ntorque", "[motor_2] id = 127, but it must lie between 1 and 126"),
    ("sign = -1", "sign = 2", "[motor_2] sign = 2, but it must be 1 or -1"),
    ("sign = -1", "gear = 2", "[motor_2] gear = 2.0, but it must be that of motor 1, 1"),
    ("torque_limit = 38.0 ", "torque_limit = inf ", "[motor_1] torque_limit = inf, but it must be positive"),
    ("zero = 0.0 ", "zero = 1e9 ", "[motor_1] zero = 1000000000.0, but it must lie within ±128 turns"),
    ("source = 1 ", "source = 0 ", "[boom_horizontal] source = 0, but it must be 1 or 2"),
    ("counts_per_turn = 5000", "counts_per_turn = 5e3", "[boom_horizontal] counts_per_turn = 5000.0, but it must be a"),
    ("id = 2\nsource = 1", "id = 3\nsource = 1", "[boom_vertical] id = 3, but it must be 1 or 2"),
    ("id = 2\nsource = 1", "id = 1\nsource = 1", "[boom_vertical] source = 1, but it must differ from the horizontal"),
    ("pin = 1", "pin = 6", "[contact] pin = 6, but it must lie between 1 and 5"),
    ("port = 2", "port = 3", "[contact] port = 3, but it must be 1 or 2"),
    ("zero = 400", "zero = -1", "[contact] zero = -1, but it must lie between 0 and 4096"),
    ("newton_per_count = 0.1", "newton_per_count = 0", "[contact] newton_per_count = 0.0, but it must be finite"),
    ("torque = 38.0 ", "torqe = 38.0 ", "[limits] torqe: unknown key; did you mean torque?"),
]


@pytest.mark.parametrize(("old", "new", "expected"), WRONG)
def test_errors_state_what_is_valid(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert TEXT.count(old) >= 1
    with pytest.raises(InputError) as caught:
        read(tmp_path, TEXT.replace(old, new, 1))
    message = str(caught.value)
    assert message.removeprefix(f"{tmp_path / 'moteus.toml'}: ").startswith(expected)
    assert "\n" not in message


@settings(deadline=None)
@given(
    at=st.sampled_from([at for at, line in enumerate(TEXT.splitlines()) if " = " in line and '"' not in line]),
    value=st.one_of(
        st.floats().map(str), st.integers().map(str), st.booleans().map(lambda yes: str(yes).lower()), st.just("[]")
    ),
)
def test_any_number_is_accepted_or_refused_in_one_line(tmp_path_factory: pytest.TempPathFactory, at: int, value: str):
    lines = TEXT.splitlines()
    lines[at] = f"{lines[at].partition(' = ')[0]} = {value}"
    try:
        settings = read(tmp_path_factory.getbasetemp(), "\n".join(lines))
    except InputError as error:
        message = str(error)
    else:
        message = ""
        assert 0 < settings.motor_1.torque_limit < inf
        assert 0 < settings.watchdog <= 0.5
        assert isfinite(hopper_sensors(hopper_on_moteus(settings, RobotParameters()).sensor_model).motor_counts)
    assert "\n" not in message


@pytest.mark.parametrize("sign", [1, -1])
def test_a_controller_reports_the_torque_at_the_link_that_it_was_commanded(sign: int) -> None:
    motor = Controller(id=1, torque_limit=20.0, gear=4.0, sign=sign)
    command = motor.torque_command(6.0)
    assert command["feedforward_torque"] == sign * 1.5
    assert command["maximum_torque"] == 5.0
    assert command["kp_scale"] == command["kd_scale"] == 0.0
    assert motor.torque_at_link(command["feedforward_torque"]) == 6.0
