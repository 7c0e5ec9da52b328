"""What a recording holds, and what can be read of one that is not whole."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Attachment, Channel, Footer, Message, Metadata, Schema

from foundation.recording.decoding import Damage, walk
from foundation.recording.mcap_file import Entries, Format, McapFile, Topic


class Contents(NamedTuple):
    """What a recording holds beside its messages. ``complete``: it was closed; ``stray``: messages of
    channels that are not known.
    """

    topics: dict[int, Topic]
    metadata: dict[str, dict[str, str]]
    attachments: tuple[Attachment, ...]
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
    """What the recording at ``path`` holds, every checksum of its messages verified.

    Raises OSError when it cannot be read, RecordingUnreadable for what is no recording at all.
    """
    gathered = _Gathered()
    with path.open("rb") as stream:
        for record in walk(stream):
            gathered.take(record)
    return gathered.contents()


class _Gathered:
    """What is known of a recording so far."""

    def __init__(self) -> None:
        self._schemas: dict[int, Schema] = {}
        self._topics: dict[int, Topic] = {}
        self._metadata: dict[str, dict[str, str]] = {}
        self._attachments: list[Attachment] = []
        self._counts: dict[int, int] = {}
        self._damages: list[Damage] = []
        self._times_ns: list[int] = []
        self._complete = False
        self._stray = 0

    def take(self, record: Any) -> None:
        """Count one record."""
        self._complete = isinstance(record, Footer)
        match record:
            case Message():
                self._message(record)
            case Schema():
                self._schemas.setdefault(record.id, record)
            case Channel():
                self._topics.setdefault(record.id, _topic(record, self._schemas.get(record.schema_id)))
            case Metadata():
                self._metadata.setdefault(record.name, record.metadata)
            case Attachment():
                self._attachments.append(record)
            case Damage():
                self._damages.append(record)

    def contents(self) -> Contents:
        """All of it."""
        first_ns, last_ns = self._times_ns or (0, 0)
        return Contents(
            self._topics,
            self._metadata,
            tuple(self._attachments),
            self._counts,
            first_ns,
            last_ns,
            tuple(self._damages),
            self._complete,
            self._stray,
        )

    def _message(self, record: Message) -> None:
        if record.channel_id not in self._topics:
            self._stray += 1
            return
        self._counts[record.channel_id] = self._counts.get(record.channel_id, 0) + 1
        first_ns, last_ns = self._times_ns or (record.log_time, record.log_time)
        self._times_ns = [min(first_ns, record.log_time), max(last_ns, record.log_time)]


def recover(source: Path, target: Path) -> Contents:
    """Write all that can be read of ``source`` to ``target``, in its order; return what that is.

    A whole file comes out as it went in, message for message. Raises FileExistsError where ``target``
    exists, OSError, RecordingUnreadable.
    """
    found = contents(source)
    numbers = {channel: number for number, channel in enumerate(found.topics)}
    topics = list(found.topics.values())
    with (
        new_recording(target, topics, found.metadata, found.attachments) as file,
        source.open("rb") as stream,
    ):
        for record in walk(stream):
            if isinstance(record, Message) and record.channel_id in numbers:
                file.add(numbers[record.channel_id], record.data, record.log_time, record.publish_time)
    return found


@contextmanager
def new_recording(
    path: Path, topics: Sequence[Topic], metadata: Entries, attachments: Sequence[Attachment] = ()
) -> Iterator[McapFile]:
    """A recording at ``path``, whole at the end of the block; where the block fails there is none.

    Raises FileExistsError where it exists, OSError when it cannot be written.
    """
    file = McapFile(path, topics, metadata, attachments)
    try:
        yield file
        file.close()
    except BaseException:
        file.abandon()
        path.unlink(missing_ok=True)
        raise


def _topic(channel: Channel, schema: Schema | None) -> Topic:
    said = ("", "", b"") if schema is None else (schema.name, schema.encoding, schema.data)
    form = Format(*said, channel.message_encoding)
    return Topic(channel.topic, form, bytes, tuple(channel.metadata.items()))
