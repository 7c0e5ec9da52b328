"""The plant behind its own coupler, and a record of everything that reached its registers.

The fault cases are judged here, at the end of the chain: what was written to the output registers, and what
the true spools did. What a controller says about itself proves nothing.
"""

import struct
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from plant_emulator.core.plant import Plant
from plant_emulator.shell.coupler import Coupler
from protocol.process_image import (
    CONTROL_ENABLE,
    INPUT_ADDRESS,
    INPUT_WORDS,
    OUTPUT_ADDRESS,
    OUTPUT_WORDS,
    SensorImage,
    ValveImage,
    decode_sensors,
    encode_sensors,
    encode_valves,
)

WRITER_RELEASE_NS = 1_000_000_000
SHUT = 2e-3  # of spool: inside the valve's overlap no oil flows


class Written(NamedTuple):
    """A whole image that arrived in the output registers at the plant's ``time_ns``."""

    time_ns: int
    image: ValveImage

    @property
    def enables(self) -> bool:
        """Whether the valves may follow it."""
        return bool(self.image.control & CONTROL_ENABLE)

    @property
    def drives(self) -> bool:
        """Whether it can move anything."""
        return self.enables and any(self.image.valves)


class Spools(NamedTuple):
    """The true spools (6,) at ``time_ns``."""

    time_ns: int
    opening: np.ndarray


class Registers:
    """Stands where a Plant stands; every exchange is an FC 23 request answered by the coupler.

    ``written``: images in order of arrival; ``spools``: truth after every step. ``sensors``: turns what the
    sensors say into what the coupler is given, for faults of which the plant knows nothing.
    """

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.written: list[Written] = []
        self.spools: list[Spools] = []
        self.sensors: Callable[[SensorImage], SensorImage] = lambda image: image
        self.coupler = Coupler(self._words, self._arrived, WRITER_RELEASE_NS, lambda: plant.time_ns)
        self._answered = self._words()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.plant, name)

    def write(self, image: ValveImage) -> None:
        """The controller's exchange: its image in, the newest inputs out."""
        head = struct.pack(
            ">BHHHHB", 23, INPUT_ADDRESS, INPUT_WORDS, OUTPUT_ADDRESS, OUTPUT_WORDS, 2 * OUTPUT_WORDS
        )
        answer = self.coupler.answer(
            "controller", 1, head + struct.pack(f">{OUTPUT_WORDS}H", *encode_valves(image))
        )
        assert answer[0] == 23, answer.hex()
        self._answered = list(struct.unpack(f">{INPUT_WORDS}H", answer[2:]))

    def read(self) -> SensorImage:
        """The inputs that came with the last exchange."""
        return decode_sensors(self._answered)

    def advance(self, duration_ns: int) -> None:
        """Let the plant's time pass."""
        self.plant.advance(duration_ns)
        self.spools.append(Spools(self.plant.time_ns, self.plant.truth().spools))

    def _words(self) -> list[int]:
        return encode_sensors(self.sensors(self.plant.read()))

    def _arrived(self, image: ValveImage) -> None:
        self.plant.write(image)
        self.written.append(Written(self.plant.time_ns, image))


def assert_shut(registers: Registers, after_ns: int) -> None:
    """Asserts that from ``after_ns`` on no image could move anything, and that the true spools are shut."""
    driving = [row for row in registers.written if row.time_ns > after_ns and row.drives]
    assert not driving, f"{len(driving)} images drive the valves after {after_ns / 1e9} s: {driving[0]}"
    open_ = [row for row in registers.spools if row.time_ns > after_ns and np.abs(row.opening).max() > SHUT]
    assert not open_, f"spools open {(open_[-1].time_ns - after_ns) / 1e6} ms after the limit: {open_[-1]}"


def shut_since(registers: Registers) -> int:
    """The plant's time (ns) from which on the true spools have been shut."""
    last = 0
    for row in registers.spools:
        if np.abs(row.opening).max() > SHUT:
            last = row.time_ns
    return last


def assert_driving(registers: Registers, after_ns: int) -> None:
    """Asserts that the valves were driven after ``after_ns``: the control of a case that expects nothing."""
    assert any(row.drives for row in registers.written if row.time_ns > after_ns)
    assert any(np.abs(row.opening).max() > SHUT for row in registers.spools if row.time_ns > after_ns)
