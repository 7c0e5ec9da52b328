"""Reading a recording, also one that was cut off or damaged: whatever can be read is, the rest is named."""

import struct
import zlib
from collections.abc import Callable, Container, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Footer, Header, Message, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from protocol.errors import LongreachError

_HEAD = struct.Struct("<BQ")
_READERS: dict[int, Callable[[ReadDataStream], Any]] = {
    Opcode.HEADER: Header.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.STATISTICS: Statistics.read,
    Opcode.FOOTER: Footer.read,
}
_BROKEN = (McapError, struct.error, ValueError, zstandard.ZstdError, MemoryError)
_CHUNK_MAX = 1 << 30  # what a chunk may unpack to


class RecordingUnreadable(LongreachError):
    """A file that is no recording. ``cause``: recording.no_recording."""


class Damage(NamedTuple):
    """What could not be read at ``offset`` of the file."""

    offset: int
    what: str


def walk(stream: BinaryIO) -> Iterator[Any]:
    """The records of ``stream`` in their order, those of chunks too, and a ``Damage`` for what is unreadable.

    Chunks and indexes themselves are left out. A last Footer tells that the file was closed. Raises
    RecordingUnreadable for what does not begin as an MCAP file does.
    """
    if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        name = Path(str(getattr(stream, "name", "?"))).name
        raise RecordingUnreadable("recording.no_recording", f"{name}: does not begin as an MCAP file does")
    while True:
        offset = stream.tell()
        head = stream.read(_HEAD.size)
        if not head or head == MCAP0_MAGIC:
            return
        if len(head) < _HEAD.size:
            yield Damage(offset, "cut off within the head of a record")
            return
        opcode, length = _HEAD.unpack(head)
        content = stream.read(length) if length < 1 << 40 else b""
        if len(content) < length:
            yield Damage(offset, f"cut off: {len(content)} of {length} bytes of a record")
            return
        yield from _found(opcode, content, offset)
        if opcode == Opcode.FOOTER:
            if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                yield Damage(stream.tell(), "cut off within the last bytes")
            return


def messages(
    path: Path, topics: Container[str], damages: list[Damage] | None = None
) -> Iterator[tuple[str, Message]]:
    """The messages of ``topics`` in the recording at ``path``, in its order, each with its topic.

    What of the file could not be read goes into ``damages``. Raises as ``walk``, OSError.
    """
    named: dict[int, str] = {}
    with path.open("rb") as stream:
        for record in walk(stream):
            if isinstance(record, Channel):
                named[record.id] = record.topic
            elif isinstance(record, Message) and named.get(record.channel_id) in topics:
                yield named[record.channel_id], record
            elif isinstance(record, Damage) and damages is not None:
                damages.append(record)


def _found(opcode: int, content: bytes, offset: int) -> Iterator[Any]:
    try:
        if opcode == Opcode.CHUNK:
            yield from _in_chunk(_unpacked(Chunk.read(ReadDataStream(BytesIO(content)))))
        elif opcode == Opcode.MESSAGE:
            yield Message.read(ReadDataStream(BytesIO(content)), len(content))
        elif opcode in _READERS:
            yield _READERS[opcode](ReadDataStream(BytesIO(content)))
    except _BROKEN as error:
        kind = "chunk" if opcode == Opcode.CHUNK else "record"
        yield Damage(offset, f"damaged {kind}: {error or type(error).__name__}")


def _unpacked(chunk: Chunk) -> bytes:
    """What a chunk holds. Raises ValueError when it is not what was written."""
    if chunk.uncompressed_size > _CHUNK_MAX:
        raise ValueError(f"{chunk.uncompressed_size} bytes unpacked, {_CHUNK_MAX} at most")
    if chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().decompress(chunk.data, chunk.uncompressed_size)
    elif chunk.compression == "lz4":
        import lz4.frame  # the library's own extra, for files of others

        data = lz4.frame.decompress(chunk.data)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"compression {chunk.compression!r} is not known")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError(f"checksum {zlib.crc32(data):#010x}, written as {chunk.uncompressed_crc:#010x}")
    return bytes(data)


def _in_chunk(data: bytes) -> Iterator[Any]:
    place = 0
    while place < len(data):
        opcode, length = _HEAD.unpack_from(data, place)
        place += _HEAD.size
        content = data[place : place + length]
        place += length
        if opcode == Opcode.MESSAGE:
            yield Message.read(ReadDataStream(BytesIO(content)), length)
        elif opcode in _READERS:
            yield _READERS[opcode](ReadDataStream(BytesIO(content)))
