"""An MCAP file as it grows, by the ``mcap`` library's writer: chunks that a kill does not take along.

The library keeps the index of its chunks in memory until the file is closed, some megabytes an hour.
"""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mcap.writer import Writer

LIBRARY = "longreach"
# [D] A kill loses the chunk that is open: less than 0.6 s with what the writing itself takes, and with what a
# loaded machine keeps the thread waiting. With 0.4 s files are 2.5 % smaller.
CHUNK_NS = 250_000_000
CHUNK_BYTES = 1 << 18  # an upper bound; time closes a chunk sooner


class Format(NamedTuple):
    """What the messages of a topic are: ``schema`` its name, ``data`` its text, ``encoding`` of schema and
    of message as MCAP's registry of well-known encodings names them. Without name and encoding there is none.
    """

    schema: str
    schema_encoding: str
    data: bytes
    message_encoding: str


class Topic(NamedTuple):
    """One topic of a recording. ``encode`` returns the bytes of what is recorded on it. ``once``: it is
    recorded once, and who looks later wants it too.
    """

    name: str
    format: Format
    encode: Callable[[Any], bytes]
    once: bool = False


Entries = Mapping[str, Mapping[str, str]]  # metadata: records by name, text by key


class McapFile:
    """Writes a recording of known topics. Not for two threads at once. ``messages``: how many were added."""

    def __init__(self, path: Path, topics: Sequence[Topic], metadata: Entries) -> None:
        """Create ``path``. Raises FileExistsError where it exists, OSError when it cannot be written."""
        self.path = path
        self.messages = 0
        self._topics = tuple(topics)
        self._file = path.open("xb")
        self._writer = Writer(self._file, CHUNK_BYTES)
        self._writer.start(library=LIBRARY)
        for name, entries in metadata.items():
            self._writer.add_metadata(name, dict(entries))
        schemas: dict[tuple[str, str, bytes], int] = {("", "", b""): 0}
        for topic in topics:
            key = topic.format[:3]
            if key not in schemas:
                schemas[key] = self._writer.register_schema(*key)
            self._writer.register_channel(topic.name, topic.format.message_encoding, schemas[key])
        self._chunk_ns: int | None = None  # of the first message of the open chunk
        self.flush()

    def add(self, topic: int, message: Any, log_ns: int, publish_ns: int) -> bytes:
        """Add a message to topic number ``topic``, and close the chunk when it is due; return it encoded.

        Raises OSError when a chunk cannot be written, such as on a full disk.
        """
        data = self._topics[topic].encode(message)
        if self._chunk_ns is not None and log_ns - self._chunk_ns >= CHUNK_NS:
            self.flush()
        if self._chunk_ns is None:
            self._chunk_ns = log_ns
        self._writer.add_message(topic + 1, log_ns, data, publish_ns)
        self.messages += 1
        return data

    def flush(self) -> None:
        """Hand the open chunk to the operating system: a kill of this process then leaves it whole."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._chunk_ns, self._whole = None, self._file.tell()

    def close(self) -> None:
        """Write the summary and close the file. Raises OSError when it cannot be written."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.flush()
            self._whole = self._file.tell()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file without a summary: readers take it as cut off. What a full disk took of a chunk is
        taken back.
        """
        if not self._file.raw.closed:
            with contextlib.suppress(OSError):
                self._file.raw.truncate(self._whole)
            self._file.raw.close()
