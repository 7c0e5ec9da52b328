"""What was recorded beside what comes out again: to the last bit, or within a limit, and where they part."""

import csv
import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Message

from foundation.recording.decoding import Values, decoder, walk
from foundation.recording.messages import format_of
from foundation.recording.recovery import contents
from vision_pc.shell.recording import vision_messages as own

TIMES = ("log_time_ns", "publish_time_ns")


def write_tables(source: Path, directory: Path) -> tuple[dict[str, int], list[str]]:
    """Write ``directory``/TOPIC.csv for every topic of ``source``; return rows by file, and topics left out
    because their encoding is not known.

    What a message does not have is an empty cell. Raises FileExistsError where a file is there.
    """
    found = contents(source)
    directory.mkdir(parents=True, exist_ok=True)
    rows, left_out = {}, []
    for channel, topic in found.topics.items():
        decode = decoder(topic.format)
        if decode is None:
            left_out.append(topic.name)
            continue
        columns: dict[str, None] = {}
        with source.open("rb") as stream:
            for record in walk(stream):
                if isinstance(record, Message) and record.channel_id == channel:
                    columns |= dict.fromkeys(decode(record.data))
        path = directory / f"{topic.name.strip('/').replace('/', '_')}.csv"
        with path.open("x", newline="", encoding="utf-8") as file, source.open("rb") as stream:
            table = csv.DictWriter(file, [*TIMES, *columns])
            table.writeheader()
            for record in walk(stream):
                if isinstance(record, Message) and record.channel_id == channel:
                    times = dict(zip(TIMES, (record.log_time, record.publish_time), strict=True))
                    table.writerow(times | decode(record.data))
        rows[path.name] = found.counts.get(channel, 0)
    return rows, left_out


ALIKE = 1e-9  # of other versions or another processor: m, rad, px
REFERENCE, OPERATION = "reference", "operation"
_HAPPENED = {REFERENCE: "sent", OPERATION: "begun"}  # all others are of a frame
_DECODERS: dict[str, Callable[[bytes], Values]] = {}


class Difference(NamedTuple):
    """The first place where a replay parts from its recording, ``time_ns`` on vision's clock."""

    kind: str
    number: int
    time_ns: int
    field: str
    recorded: Any
    replayed: Any

    def in_words(self) -> str:
        """One line that says it all."""
        happened = _HAPPENED.get(self.kind, "captured")
        where = f"{self.kind} {self.number} ({happened} at {self.time_ns * 1e-9:.3f} s): {self.field}"
        return f"{where}: recorded {_as_text(self.recorded)}, replayed {_as_text(self.replayed)}"


class ReplayComparison:
    """Counts what is the same, by kind, and keeps the first that is not.

    ``exact``: the same is what has the same digest; otherwise what differs in no field by more than
    ``ALIKE``, for other versions of the libraries. ``largest`` is the largest difference of a number.
    """

    def __init__(self, exact: bool) -> None:
        self.exact = exact
        self.alike: Counter[str] = Counter()
        self.of: Counter[str] = Counter()
        self.first: Difference | None = None
        self.largest = 0.0

    @property
    def identical(self) -> bool:
        """Whether everything was the same."""
        return self.alike == self.of

    def message(
        self, kind: str, number: int, recorded: Any, replayed: bytes, time_ns: int | None = None
    ) -> bool:
        """Compare a recorded message with the bytes of a replayed one. Return whether they are the same.

        ``time_ns``: when it was; None: it says so itself.
        """
        again = type(recorded).FromString(replayed)
        digests = [getattr(message, "digest", None) for message in (recorded, again)]
        if self.exact and digests[0] is not None and digests[0] == digests[1]:
            return self.same(kind)
        stamp = _stamp(recorded) if time_ns is None else time_ns
        parted = self._first_difference(_flat(recorded), _flat(again))
        if parted is None and self.exact and digests[0] != digests[1]:
            parted = "digest", digests[0], digests[1]
        return self.same(kind) if parted is None else self.different(kind, number, stamp, *parted)

    def values(self, kind: str, number: int, time_ns: int, recorded: Values, replayed: Values) -> bool:
        """Compare values by name. Return whether they are the same."""
        parted = self._first_difference(recorded, replayed)
        return self.same(kind) if parted is None else self.different(kind, number, time_ns, *parted)

    def _first_difference(self, before: Values, now: Values) -> tuple[str, Any, Any] | None:
        """The first field that is not the same, and both its values."""
        for field in [*before, *(field for field in now if field not in before)]:
            apart = 0.0 if field == "digest" else _apart(before.get(field), now.get(field))
            self.largest = max(self.largest, apart)
            if apart > (0.0 if self.exact else ALIKE):
                return field, before.get(field), now.get(field)
        return None

    def same(self, kind: str) -> bool:
        """Count one that is the same. Return True."""
        self.of[kind] += 1
        self.alike[kind] += 1
        return True

    def different(
        self, kind: str, number: int, time_ns: int, field: str, recorded: Any, replayed: Any
    ) -> bool:
        """Count one that is not, and keep it if it is the first. Return False."""
        self.of[kind] += 1
        if self.first is None:
            self.first = Difference(kind, number, time_ns, field, recorded, replayed)
        return False


def _flat(message: Any) -> Values:
    kind = type(message)
    name = kind.DESCRIPTOR.full_name
    if name not in _DECODERS:
        made = decoder(format_of(kind))
        assert made is not None
        _DECODERS[name] = made
    return _DECODERS[name](message.SerializeToString())


def _apart(before: Any, now: Any) -> float:
    """How far two values are apart: infinitely, where they are no numbers and not the same."""
    if isinstance(before, float) and isinstance(now, float):
        if math.isnan(before) and math.isnan(now):
            return 0.0
        return abs(before - now) if math.isfinite(before - now) else math.inf
    return 0.0 if before == now else math.inf


def _stamp(message: Any) -> int:
    if isinstance(message, own.LookMessage):
        return int(message.time_ns)
    if isinstance(message, own.CameraErrorsMessage):
        return int(message.captures_ns[-1]) if message.captures_ns else 0
    return int(message.capture_ns)


def _as_text(value: Any) -> str:
    return "nothing" if value is None else repr(value)
