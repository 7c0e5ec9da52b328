"""An MCAP file as it grows: chunks that a kill does not take along, and an index that stays out of memory.

The records are those of the ``mcap`` library. Its writer, as that of foxglove-sdk, keeps an index entry of
0.2 to 0.7 kB in memory for every chunk until the file is closed: at two chunks a second 2 to 5 MB an hour.
Here the entries wait in an unnamed file beside the recording.
"""

import contextlib
import struct
import tempfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

LIBRARY = "longreach"
# [D] A kill loses the chunk that is open: less than 0.6 s with what the writing itself takes, and with what a
# loaded machine keeps the thread waiting. With 0.4 s files are 2.5 % smaller.
CHUNK_NS = 250_000_000
CHUNK_BYTES = 1 << 18  # an upper bound; time closes a chunk sooner
_LEVEL = 1  # of zstd: twice as fast as its default of 3 and 3 % larger on truths
_MESSAGE = struct.Struct("<BQHIQQ")


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
    """Writes a recording of known topics. Not for two threads at once.

    Whole chunks only reach the file, each with its message index in one write. ``messages``: how many were
    added.
    """

    def __init__(self, path: Path, topics: Sequence[Topic], metadata: Entries) -> None:
        """Create ``path``. Raises FileExistsError where it exists, OSError when it cannot be written."""
        self.path = path
        self._topics = tuple(topics)
        self._schemas, self._channels = _schemas_and_channels(self._topics)
        self._file = path.open("xb", buffering=0)
        self._size = 0
        self._index = tempfile.TemporaryFile(dir=path.parent)  # noqa: SIM115  closed with the recording
        self._metadata_index: list[MetadataIndex] = []
        self._compressor = zstandard.ZstdCompressor(level=_LEVEL)
        self._chunk = bytearray()
        self._places: dict[int, list[tuple[int, int]]] = {}
        self._counts = [0] * len(self._topics)
        self._chunk_ns = 0  # of the first message of the open chunk
        self._chunks = 0
        self._first_ns: int | None = None
        self._last_ns = 0
        self._write(MCAP0_MAGIC + _bytes(Header("", LIBRARY), *self._schemas, *self._channels))
        for name, entries in metadata.items():
            record = _bytes(Metadata(name, dict(entries)))
            self._metadata_index.append(MetadataIndex(self._size, len(record), name))
            self._write(record)

    @property
    def messages(self) -> int:
        """How many messages were added."""
        return sum(self._counts)

    @property
    def waiting(self) -> bool:
        """Whether there are messages that a kill would take along."""
        return bool(self._chunk)

    def add(self, topic: int, message: Any, log_ns: int, publish_ns: int) -> bytes:
        """Add a message to topic number ``topic``, and close the chunk when it is due; return it encoded.

        Raises OSError when a chunk cannot be written, such as on a full disk.
        """
        data = self._topics[topic].encode(message)
        channel = topic + 1
        if self._places and log_ns - self._chunk_ns >= CHUNK_NS:
            self.flush()
        if not self._places:
            self._chunk_ns = log_ns
        self._places.setdefault(channel, []).append((log_ns, len(self._chunk)))
        sequence = self._counts[topic] & 0xFFFF_FFFF
        size = _MESSAGE.size - 9 + len(data)
        self._chunk += _MESSAGE.pack(Opcode.MESSAGE, size, channel, sequence, log_ns, publish_ns)
        self._chunk += data
        self._counts[topic] += 1
        if len(self._chunk) >= CHUNK_BYTES:
            self.flush()
        return data

    def flush(self) -> None:
        """Hand the open chunk to the operating system: a kill of this process then leaves it whole."""
        if not self._places:
            return
        places, self._places = self._places, {}
        content, self._chunk = self._chunk, bytearray()
        times = [log_ns for entries in places.values() for log_ns, _ in entries]
        first_ns, last_ns = min(times), max(times)
        packed = self._compressor.compress(content)
        chunk = _bytes(
            Chunk(
                compression="zstd",
                data=packed,
                message_start_time=first_ns,
                message_end_time=last_ns,
                uncompressed_crc=zlib.crc32(content),
                uncompressed_size=len(content),
            )
        )
        written = bytearray(chunk)
        offsets: dict[int, int] = {}
        for channel, entries in places.items():
            offsets[channel] = self._size + len(written)
            written += _bytes(MessageIndex(channel, entries))
        index = ChunkIndex(
            chunk_length=len(chunk),
            chunk_start_offset=self._size,
            compression="zstd",
            compressed_size=len(packed),
            message_end_time=last_ns,
            message_index_length=len(written) - len(chunk),
            message_index_offsets=offsets,
            message_start_time=first_ns,
            uncompressed_size=len(content),
        )
        self._write(written)
        self._index.write(_bytes(index))
        self._chunks += 1
        self._first_ns = first_ns if self._first_ns is None else min(self._first_ns, first_ns)
        self._last_ns = max(self._last_ns, last_ns)

    def close(self) -> None:
        """Write the summary and close the file. Raises OSError when it cannot be written."""
        try:
            self.flush()
            self._write(_bytes(DataEnd(0)))
            self._write_summary()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file as it is, without a summary: readers then take it as cut off."""
        self._index.close()
        self._file.close()

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self._topics),
            channel_message_counts={number: n for number, n in enumerate(self._counts, 1) if n},
            chunk_count=self._chunks,
            message_count=self.messages,
            message_end_time=self._last_ns,
            message_start_time=self._first_ns or 0,
            metadata_count=len(self._metadata_index),
            schema_count=len(self._schemas),
        )

    def _write_summary(self) -> None:
        """Schemas, channels, statistics and indexes, as the format wants them at the end."""
        start, crc = self._size, 0
        offsets: list[SummaryOffset] = []
        groups: list[tuple[Opcode, list[Any]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.METADATA_INDEX, self._metadata_index),
        ]
        for opcode, records in groups:
            if not records:
                continue
            group = _bytes(*records)
            offsets.append(SummaryOffset(opcode, self._size, len(group)))
            crc = zlib.crc32(group, crc)
            self._write(group)
        chunks_start = self._size
        self._index.seek(0)
        while part := self._index.read(1 << 16):
            crc = zlib.crc32(part, crc)
            self._write(part)
        if self._chunks:
            offsets.append(SummaryOffset(Opcode.CHUNK_INDEX, chunks_start, self._size - chunks_start))
        offset_start = self._size
        said = _bytes(*offsets)
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        crc = zlib.crc32(footer, zlib.crc32(said, crc))
        self._write(said + _bytes(Footer(start, offset_start, crc)) + MCAP0_MAGIC)

    def _write(self, data: bytes | bytearray) -> None:
        """All of ``data``, or nothing of it: what a full disk takes of it is taken back."""
        view, begun = memoryview(data), self._size
        try:
            while view:
                written = self._file.write(view)
                self._size += written
                view = view[written:]
        except OSError:
            self._size = begun
            with contextlib.suppress(OSError):
                self._file.truncate(begun)
            raise


def _schemas_and_channels(topics: Sequence[Topic]) -> tuple[list[Schema], list[Channel]]:
    """A record for every topic, and for every schema that they name."""
    schemas: dict[tuple[str, str, bytes], Schema] = {}
    channels = []
    for number, topic in enumerate(topics, 1):
        said = topic.format
        key = (said.schema, said.schema_encoding, said.data)
        if any(key) and key not in schemas:
            schemas[key] = Schema(len(schemas) + 1, said.data, said.schema_encoding, said.schema)
        schema_id = schemas[key].id if any(key) else 0
        channels.append(Channel(number, topic.name, said.message_encoding, {}, schema_id))
    return list(schemas.values()), channels


def _bytes(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
