"""The fieldbus process image: one table of registers, and the two images as plain data."""

from typing import NamedTuple


class SensorImage(NamedTuple):
    """Plant → controller, in the fieldbus's own units (raw counts and scaled integers already decoded to SI).

    ``encoder_counts``: six signed counts, ``2**17`` to the turn, slew lift tilt wrist1 wrist2 wrist3.
    ``pressures_bar``: per actuator chamber a, chamber b (gauge-free, absolute).
    """

    plant_cycle: int
    echo_cycle: int
    status: int
    encoder_counts: tuple[int, int, int, int, int, int]
    pressures_bar: tuple[tuple[float, float], ...]
    supply_bar: float
    return_bar: float
    oil_temperature_degc: float


class ValveImage(NamedTuple):
    """Controller → plant. ``valves`` are spool commands in −1…1, positive extends (raises the joint angle)."""

    controller_cycle: int
    control: int
    valves: tuple[float, float, float, float, float, float]


# bits of SensorImage.status
STATUS_SUPPLY_ON = 1 << 0
STATUS_VALVES_ENABLED = 1 << 1
STATUS_WATCHDOG_TRIPPED = 1 << 2
STATUS_SENSOR_FAULT = 1 << 3

# bits of ValveImage.control
CONTROL_ENABLE = 1 << 0
CONTROL_RESET_WATCHDOG = 1 << 1

COUNTS_PER_TURN = 1 << 17
VALVE_FULL_SCALE = 32767
