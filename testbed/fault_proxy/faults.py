"""What may happen to what passes, and the seeded draws that decide it; no sockets and no clock in here."""

from dataclasses import dataclass
from enum import Enum
from typing import Annotated, NamedTuple

import typer

from protocol.errors import ConfigurationError

MS = 1_000_000
Chance = Annotated[float, typer.Option(min=0.0, max=1.0)]
Time = Annotated[float, typer.Option(min=0.0, max=60_000.0)]
_PROBABILITIES = ("loss", "burst", "duplicate", "reorder", "truncate", "corrupt")


@dataclass(frozen=True, slots=True)
class Faults:
    """Probabilities of 0…1 a packet, and times in ms.

    ``burst``: that a run of ``burst_length`` losses begins. ``delay_ms`` to all and up to ``jitter_ms`` more,
    uniformly, which alone reorders UDP where it exceeds the spacing. ``reorder``: a packet that waits
    ``reorder_ms`` longer. ``truncate``: cut at a random byte. ``corrupt``: one random bit flipped.
    ``half_open_after_ms``: from then on nothing passes and nobody is told (negative: never).
    """

    loss: Chance = 0.0
    burst: Chance = 0.0
    burst_length: Annotated[int, typer.Option(min=1)] = 4
    delay_ms: Time = 0.0
    jitter_ms: Time = 0.0
    duplicate: Chance = 0.0
    reorder: Chance = 0.0
    reorder_ms: Time = 20.0
    truncate: Chance = 0.0
    corrupt: Chance = 0.0
    half_open_after_ms: Annotated[float, typer.Option(help="From then on nothing passes; -1: never.")] = -1.0

    def __post_init__(self) -> None:
        for name in _PROBABILITIES:
            value = getattr(self, name)
            if not 0.0 <= value <= 1.0:
                raise ConfigurationError("proxy.probability", f"{name} = {value}: wanted 0…1")
        for name in ("delay_ms", "jitter_ms", "reorder_ms"):
            value = getattr(self, name)
            if not 0.0 <= value <= 60_000.0:
                raise ConfigurationError("proxy.time", f"{name} = {value}: wanted 0…60000 ms")
        if self.burst_length < 1:
            raise ConfigurationError("proxy.burst", f"burst_length = {self.burst_length}: wanted 1 or more")


class Event(Enum):
    """What happened to a packet."""

    PASSED = "passed"
    LOST = "lost"
    LOST_IN_BURST = "lost_in_burst"
    DUPLICATED = "duplicated"
    REORDERED = "reordered"
    TRUNCATED = "truncated"
    CORRUPTED = "corrupted"
    SWALLOWED = "swallowed"


class Delivery(NamedTuple):
    """Bytes to hand on after ``delay_ns``."""

    delay_ns: int
    data: bytes


class FaultLine:
    """One direction. The n-th packet meets the same fate for the same seed, whatever the packets before held.

    ``counts``: how often each event happened.
    """

    def __init__(self, faults: Faults, seed: int, direction: int) -> None:
        import numpy as np  # here, so that the help of the command need not wait for it

        self.counts = dict.fromkeys(Event, 0)
        self._faults = faults
        self._rng = np.random.default_rng([seed, direction])
        self._burst_left = 0

    def fate(self, data: bytes, elapsed_ns: int) -> list[Delivery]:
        """The deliveries that ``data`` becomes, ``elapsed_ns`` after the proxy began; empty: lost."""
        faults = self._faults
        # A fixed number of draws a packet, so that one kind of fault does not shift another's.
        lost, burst, twice, late, cut, bent, jitter, again, place = self._rng.random(9)
        if 0.0 <= faults.half_open_after_ms * MS <= elapsed_ns:
            return self._nothing(Event.SWALLOWED)
        if self._burst_left == 0 and burst < faults.burst:
            self._burst_left = faults.burst_length
        if self._burst_left:
            self._burst_left -= 1
            return self._nothing(Event.LOST_IN_BURST)
        if lost < faults.loss:
            return self._nothing(Event.LOST)
        if cut < faults.truncate and data:
            data = data[: int(place * len(data))]
            self.counts[Event.TRUNCATED] += 1
        if bent < faults.corrupt and data:
            bit = int(place * 8 * len(data))
            data = data[: bit // 8] + bytes([data[bit // 8] ^ 1 << bit % 8]) + data[bit // 8 + 1 :]
            self.counts[Event.CORRUPTED] += 1
        delay_ms = faults.delay_ms + jitter * faults.jitter_ms
        if late < faults.reorder:
            delay_ms += faults.reorder_ms
            self.counts[Event.REORDERED] += 1
        deliveries = [Delivery(round(delay_ms * MS), data)]
        if twice < faults.duplicate:
            deliveries.append(Delivery(round((delay_ms + again * faults.jitter_ms) * MS), data))
            self.counts[Event.DUPLICATED] += 1
        self.counts[Event.PASSED] += 1
        return deliveries

    def as_dict(self) -> dict[str, int]:
        """The counts by name."""
        return {event.value: count for event, count in self.counts.items()}

    def _nothing(self, event: Event) -> list[Delivery]:
        self.counts[event] += 1
        return []
