"""What a recording holds, also one that was cut off or damaged: every checksum is verified."""

from pathlib import Path
from typing import NamedTuple

from mcap.records import Channel, Footer, Message, Metadata, Schema

from foundation.recording.decoding import Damage, walk
from foundation.recording.mcap_file import Format, Topic


class Contents(NamedTuple):
    """What a recording holds beside its messages. ``complete``: it was closed; ``stray``: messages of
    channels that are not known.
    """

    topics: dict[int, Topic]
    metadata: dict[str, dict[str, str]]
    counts: dict[int, int]
    first_ns: int
    last_ns: int
    damages: tuple[Damage, ...]
    complete: bool
    stray: int

    @property
    def messages(self) -> int:
        """How many messages there are of known channels."""
        return sum(self.counts.values())


def contents(path: Path) -> Contents:
    """What the recording at ``path`` holds.

    Raises OSError when it cannot be read, RecordingUnreadable for what is no recording at all.
    """
    schemas: dict[int, Schema] = {}
    topics: dict[int, Topic] = {}
    metadata: dict[str, dict[str, str]] = {}
    counts: dict[int, int] = {}
    damages: list[Damage] = []
    first_ns = last_ns = stray = 0
    complete = False
    with path.open("rb") as stream:
        for record in walk(stream):
            complete = isinstance(record, Footer)
            if isinstance(record, Message) and record.channel_id in topics:
                first_ns = min(first_ns, record.log_time) if counts else record.log_time
                last_ns = max(last_ns, record.log_time)
                counts[record.channel_id] = counts.get(record.channel_id, 0) + 1
            elif isinstance(record, Message):
                stray += 1
            elif isinstance(record, Schema):
                schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                topics.setdefault(record.id, _topic(record, schemas.get(record.schema_id)))
            elif isinstance(record, Metadata):
                metadata.setdefault(record.name, record.metadata)
            elif isinstance(record, Damage):
                damages.append(record)
    return Contents(topics, metadata, counts, first_ns, last_ns, tuple(damages), complete, stray)


def _topic(channel: Channel, schema: Schema | None) -> Topic:
    described = ("", "", b"") if schema is None else (schema.name, schema.encoding, schema.data)
    return Topic(channel.topic, Format(*described, channel.message_encoding), bytes)
