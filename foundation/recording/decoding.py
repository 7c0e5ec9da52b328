"""Messages of a recording as plain numbers, by the schemas that the file itself carries."""

import struct
from collections.abc import Callable, Container, Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import zstandard
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from foundation.foreign_text import parse_json
from foundation.recording.mcap_file import Format
from protocol.errors import LongreachError

Values = dict[str, Any]


class UndecodableMessage(LongreachError):
    """A message that is not what its schema says. ``cause``: recording.undecodable."""


def decoder(form: Format) -> Callable[[bytes], Values] | None:
    """What turns a message into values by flat names, such as ``transforms[0].translation.x``; None for an
    encoding that is not Protobuf or JSON, or a schema that is not whole. Times are nanoseconds. What the
    message does not have is left out.
    """
    if form.message_encoding == "json":
        return lambda data: dict(_plain("", _json(form, data)))
    if form.message_encoding != "protobuf" or form.schema_encoding != "protobuf":
        return None
    try:
        made = class_in(form)
    except (TypeError, KeyError, DecodeError):  # the schema lacks a file, or is none
        return None

    def decode(data: bytes) -> Values:
        try:
            return dict(_fields("", made.FromString(data)))
        except DecodeError as error:
            raise UndecodableMessage("recording.undecodable", f"{form.schema}: {error}") from error

    return decode


def _json(form: Format, data: bytes) -> Any:
    try:
        return parse_json(data.decode())
    except ValueError as error:
        raise UndecodableMessage(
            "recording.undecodable", f"{form.schema}: {data[:40]!r} is no JSON in UTF-8"
        ) from error


def class_in(form: Format) -> Any:
    """The Protobuf class that the schema ``form`` of a file describes, its files in any order. Raises
    TypeError, KeyError or DecodeError where it is not whole.
    """
    pool = descriptor_pool.DescriptorPool()
    waiting = {file.name: file for file in descriptor_pb2.FileDescriptorSet.FromString(form.data).file}
    while waiting:  # a file after those that it imports
        ready = [file for file in waiting.values() if waiting.keys().isdisjoint(file.dependency)]
        for file in ready or waiting.values():
            pool.Add(file)
        waiting = {name: file for name, file in waiting.items() if ready and file not in ready}
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(form.schema))


def _fields(prefix: str, message: Any) -> Iterator[tuple[str, Any]]:
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        name = f"{prefix}{field.name}"
        if field.is_repeated:
            for number, item in enumerate(value):
                yield from _value(f"{name}[{number}]", field, item)
        elif not field.has_presence or message.HasField(field.name):
            yield from _value(name, field, value)


def _value(name: str, field: Any, value: Any) -> Iterator[tuple[str, Any]]:
    if field.message_type is None:
        yield name, value
    elif field.message_type.full_name in ("google.protobuf.Timestamp", "google.protobuf.Duration"):
        yield f"{name}_ns", value.seconds * 1_000_000_000 + value.nanos
    else:
        yield from _fields(f"{name}.", value)


def _plain(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _plain(f"{name}.{key}" if name else key, item)
    elif isinstance(value, list):
        for number, item in enumerate(value):
            yield from _plain(f"{name}[{number}]", item)
    elif value is not None:
        yield name, value


_HEAD = struct.Struct("<BQ")
_KEPT = {
    Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.STATISTICS, Opcode.FOOTER,
    Opcode.MESSAGE, Opcode.CHUNK,
}  # fmt: skip
_BROKEN = (McapError, struct.error, ValueError, zstandard.ZstdError, RuntimeError, MemoryError)
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
        yield from _records_in(opcode, head, content, offset)
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


def _records_in(opcode: int, head: bytes, content: bytes, offset: int) -> Iterator[Any]:
    if opcode not in _KEPT:
        return
    try:
        record = next(StreamReader(BytesIO(head + content), skip_magic=True, emit_chunks=True).records)
        yield from _in_chunk(record) if isinstance(record, Chunk) else (record,)
    except _BROKEN as error:
        kind = "chunk" if opcode == Opcode.CHUNK else "record"
        yield Damage(offset, f"damaged {kind}: {error or type(error).__name__}")


def _in_chunk(chunk: Chunk) -> list[Any]:
    """The records of a chunk. Raises one of ``_BROKEN`` when it is not what was written."""
    if chunk.uncompressed_size > _CHUNK_MAX:
        raise ValueError(f"{chunk.uncompressed_size} bytes unpacked, {_CHUNK_MAX} at most")
    if chunk.compression not in ("zstd", "lz4", ""):
        raise ValueError(f"compression {chunk.compression!r} is not known")
    return breakup_chunk(chunk, validate_crc=True)
