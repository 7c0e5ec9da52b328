"""What was recorded beside what comes out again: to the last bit, or within a limit, and where they part."""

import csv
import errno
import math
import os
import re
from collections import Counter
from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Message

from foundation.recording.decoding import Values, decoder, walk
from foundation.recording.messages import format_of
from foundation.recording.recovery import contents
from vision_pc.shell.recording import vision_messages as own

_NO_NAME = re.compile(r"[^\w .+@\-]")  # signs that some file system does not have in names
_LONGEST_NAME = 200
TIMES = ("log_time_ns", "publish_time_ns")


class TopicTable(NamedTuple):
    """A table that was written: its ``topic`` and how many ``rows`` it has."""

    topic: str
    rows: int


def table_names(topics: Mapping[int, str]) -> dict[int, str]:
    """A file's name for each channel, by its topic; no two are alike, also where case does not count."""
    names: dict[int, str] = {}
    taken: set[str] = set()
    for channel, topic in topics.items():
        stem = _NO_NAME.sub("_", topic.strip("/").replace("/", "_"))[:_LONGEST_NAME].strip(".") or "topic"
        name = next(
            name for k in count(1) if (name := stem if k == 1 else f"{stem}_{k}").lower() not in taken
        )
        taken.add(name.lower())
        names[channel] = f"{name}.csv"
    return names


def write_tables(source: Path, directory: Path) -> tuple[dict[str, TopicTable], list[str]]:
    """Write ``directory``/TOPIC.csv for every topic of ``source``; return tables by file, and topics left out
    because their encoding is not known or their schema is not whole.

    What a message does not have is an empty cell. Raises FileExistsError, before anything is written, where a
    file is there.
    """
    found = contents(source)
    names = table_names({channel: topic.name for channel, topic in found.topics.items()})
    for name in names.values():
        if (directory / name).exists():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(directory / name))
    directory.mkdir(parents=True, exist_ok=True)
    tables, left_out = {}, []
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
        path = directory / names[channel]
        with path.open("x", newline="", encoding="utf-8") as file, source.open("rb") as stream:
            table = csv.DictWriter(file, [*TIMES, *columns])
            table.writeheader()
            for record in walk(stream):
                if isinstance(record, Message) and record.channel_id == channel:
                    times = dict(zip(TIMES, (record.log_time, record.publish_time), strict=True))
                    table.writerow(times | decode(record.data))
        tables[path.name] = TopicTable(topic.name, found.counts.get(channel, 0))
    return tables, left_out


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
