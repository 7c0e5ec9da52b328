"""A recording as arrays: what any of the three parts wrote, topic by topic."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Message
from numpy.typing import NDArray

from foundation.recording.contents import Contents, contents
from foundation.recording.decoding import decoder, walk
from protocol.errors import RequestRefused

_PLACE = re.compile(r"(.*)\[(\d+)\]")


class RecordedTopic(NamedTuple):
    """The n messages of a topic: when each was written, on the writer's monotonic clock, and its columns.

    ``columns``: (n,) a number or word, (n, k) a list, (n, 4, 4) a pose ``X_…``. What a message lacks is NaN,
    0 in a column of whole numbers that has no gap, or "".
    """

    log_ns: NDArray[np.int64]
    columns: Mapping[str, NDArray[Any]]

    def __getitem__(self, name: Any) -> Any:
        """A column. Raises KeyError with what there is."""
        if name not in self.columns:
            raise KeyError(f"no {name}; there are {', '.join(self.columns)}")
        return self.columns[name]

    def to_pandas(self) -> Any:
        """A DataFrame, a row a message by ``log_ns``; ``name[i]`` is an entry of a list or of a pose by rows.

        Raises ImportError where pandas is not installed: nothing else here needs it.
        """
        import pandas

        flat: dict[str, NDArray[Any]] = {}
        for name, values in self.columns.items():
            if values.ndim == 1:
                flat[name] = values
                continue
            entries = values.reshape(len(values), -1)
            flat |= {f"{name}[{i}]": entries[:, i] for i in range(entries.shape[1])}
        return pandas.DataFrame(flat, index=pandas.Index(self.log_ns, name="log_ns"))

    def __repr__(self) -> str:
        return f"<RecordedTopic: {len(self.log_ns)} messages, {', '.join(self.columns)}>"


class ReadRecording(Mapping[str, RecordedTopic]):
    """Topic → its messages. ``metadata``, ``complete`` (closed, not cut off) and ``damages`` of the file."""

    def __init__(self, topics: Mapping[str, RecordedTopic], found: Contents) -> None:
        self._topics = topics
        self.metadata = found.metadata
        self.complete = found.complete
        self.damages = found.damages

    def __repr__(self) -> str:
        topics = ", ".join(f"{name} ({len(topic.log_ns)})" for name, topic in self._topics.items())
        return f"<ReadRecording: {topics}>"

    def __getitem__(self, topic: str) -> RecordedTopic:
        if topic not in self._topics:
            raise KeyError(f"no topic {topic}; there are {', '.join(self._topics)}")
        return self._topics[topic]

    def __iter__(self) -> Iterator[str]:
        return iter(self._topics)

    def __len__(self) -> int:
        return len(self._topics)


def read(path: Path | str, topics: Collection[str] | None = None) -> ReadRecording:
    """The recording at ``path``, also one that was cut off: everything up to the cut.

    ``topics``: those that are wanted; None: all that can be decoded. Raises OSError, RecordingUnreadable,
    and RequestRefused (``request.unknown_topic``) for a topic that is not there.
    """
    source = Path(path)
    found = contents(source)
    names = {channel: topic.name for channel, topic in found.topics.items()}
    if absent := sorted(set(topics or ()) - set(names.values())):
        why = f"{source.name}: no topic {absent[0]}; there are {', '.join(sorted(names.values()))}"
        raise RequestRefused("request.unknown_topic", why)
    decoders = {
        channel: decode
        for channel, topic in found.topics.items()
        if (topics is None or topic.name in topics) and (decode := decoder(topic.format)) is not None
    }
    # By topic: in a file that was merged one has several channels.
    rows: dict[str, list[dict[str, Any]]] = {names[channel]: [] for channel in decoders}
    times: dict[str, list[int]] = {name: [] for name in rows}
    with source.open("rb") as stream:
        for record in walk(stream):
            if isinstance(record, Message) and record.channel_id in decoders:
                rows[names[record.channel_id]].append(decoders[record.channel_id](record.data))
                times[names[record.channel_id]].append(record.log_time)
    topics_read = {
        name: RecordedTopic(np.array(times[name], np.int64), _columns(rows[name])) for name in rows
    }
    return ReadRecording(topics_read, found)


def _columns(rows: Sequence[Mapping[str, Any]]) -> dict[str, NDArray[Any]]:
    names = dict.fromkeys(name for row in rows for name in row)
    flat = {name: _column([row.get(name) for row in rows]) for name in names}
    lists: dict[str, list[tuple[int, NDArray[Any]]]] = {}
    columns: dict[str, NDArray[Any]] = {}
    for name, values in flat.items():
        if (parts := _PLACE.fullmatch(name)) is None:
            columns[name] = values
        else:
            lists.setdefault(parts[1], []).append((int(parts[2]), values))
    for name, places in lists.items():
        if name in columns:  # a number in one message, a list in another
            columns |= {f"{name}[{number}]": values for number, values in places}
            continue
        stacked = np.stack([values for _, values in sorted(places, key=lambda place: place[0])], axis=1)
        pose = name.rpartition(".")[2].startswith("X_") and stacked.shape[1] == 16
        columns[name] = stacked.reshape(-1, 4, 4) if pose else stacked
    return columns


def _column(values: Sequence[Any]) -> NDArray[Any]:
    there = [value for value in values if value is not None]
    truths = sum(isinstance(value, bool) for value in there)
    if all(isinstance(value, (int, float)) for value in there) and truths in (0, len(there)):
        if len(there) < len(values):
            return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
        return np.array(values)
    column = np.empty(len(values), dtype=object)
    column[:] = ["" if value is None else value for value in values]
    return column
