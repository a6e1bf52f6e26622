"""Temperature and bus voltage of an emulated drive against closed forms."""

from math import exp

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.hardware.ethercat.emulator.drive import PowerSettings, PowerStage, next_stage

SETTINGS = PowerSettings()
COLD = PowerStage(SETTINGS.ambient, SETTINGS.voltage)


@given(st.floats(0, 3), st.integers(1, 200))
def test_the_temperature_rises_with_the_square_of_the_torque(load: float, ticks: int) -> None:
    stage = COLD
    for _ in range(ticks):
        stage = next_stage(SETTINGS, stage, 1.0, load, 0.0)
    final = SETTINGS.ambient + SETTINGS.heating * load**2 * SETTINGS.cooling_time
    expected = final + (SETTINGS.ambient - final) * exp(-ticks / SETTINGS.cooling_time)
    assert stage.temperature == pytest.approx(expected)
    assert stage.voltage == SETTINGS.voltage


@given(st.lists(st.floats(0, 500), min_size=1, max_size=50))
def test_energy_of_a_driven_motor_is_stored_in_the_bus(powers: list[float]) -> None:
    stage = COLD
    for power in powers:
        stage = next_stage(SETTINGS, stage, 1e-3, 0.0, -power)
    stored = SETTINGS.capacity * (stage.voltage**2 - SETTINGS.voltage**2) / 2
    assert stored == pytest.approx(1e-3 * sum(powers), abs=1e-9)


@given(st.floats(0, 1e5), st.integers(1, 300))
def test_the_supply_charges_the_bus_again(power: float, ticks: int) -> None:
    drained = next_stage(SETTINGS, COLD, 1e-3, 0.0, power)
    assert 0 <= drained.voltage <= SETTINGS.voltage
    stage = drained
    for _ in range(ticks):
        stage = next_stage(SETTINGS, stage, 1e-3, 0.0, 0.0)
    gap = (SETTINGS.voltage - drained.voltage) * exp(-ticks * 1e-3 / SETTINGS.charging_time)
    assert stage.voltage == pytest.approx(SETTINGS.voltage - gap)
