"""Temperature and bus voltage of an emulated drive: losses heat it, and a motor that is driven charges the bus."""

from dataclasses import dataclass
from math import exp, sqrt
from typing import NamedTuple


@dataclass(frozen=True)
class PowerSettings:
    """Parameters of a power stage, which has a supply and a capacitor of its own.

    Attributes:
        ambient: Temperature without losses [°C].
        heating: Rate at which the rated torque heats a cold drive [K/s]; losses are proportional to the square of it.
        cooling_time: Time constant of cooling [s].
        voltage: Voltage of the supply, which gives energy but takes none back [V].
        capacity: Capacity of the bus [F]; so large that the energy of a fall changes the voltage by a few volts only.
        charging_time: Time constant with which the supply charges it [s].
    """

    ambient: float = 25.0
    heating: float = 0.1
    cooling_time: float = 300.0
    voltage: float = 48.0
    capacity: float = 0.5
    charging_time: float = 0.005


class PowerStage(NamedTuple):
    """State of a power stage.

    Attributes:
        temperature: Its temperature [°C].
        voltage: Voltage of its bus [V].
    """

    temperature: float
    voltage: float


def next_stage(
    settings: PowerSettings, stage: PowerStage, time: float, load: float, power: float, heating: float = 0.0
) -> PowerStage:
    """State after a time.

    Args:
        settings: Parameters of the power stage.
        stage: State before.
        time: The time [s].
        load: Torque, as a fraction of the rated one.
        power: Power that the motor takes from the bus, negative if it is driven [W].
        heating: Further heating [K/s].
    """
    rise = (settings.heating * load * load + heating) * settings.cooling_time
    kept = exp(-time / settings.cooling_time)
    temperature = settings.ambient + rise + (stage.temperature - settings.ambient - rise) * kept
    energy = settings.capacity * stage.voltage**2 / 2 - power * time
    voltage = sqrt(max(0.0, 2 * energy / settings.capacity))
    if voltage < settings.voltage:
        voltage = settings.voltage + (voltage - settings.voltage) * exp(-time / settings.charging_time)
    return PowerStage(temperature, voltage)
