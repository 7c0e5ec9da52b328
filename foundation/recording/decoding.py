"""Messages of a recording as plain numbers, by the schemas that the file itself carries."""

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from foundation.recording.mcap_file import Format
from protocol.errors import LongreachError

Values = dict[str, Any]


class UndecodableMessage(LongreachError):
    """A message that is not what its schema says. ``cause``: recording.undecodable."""


def decoder(form: Format) -> Callable[[bytes], Values] | None:
    """What turns a message into values by flat names, such as ``transforms[0].translation.x``; None for an
    encoding that is not Protobuf or JSON. Times are nanoseconds. What the message does not have is left out.
    """
    if form.message_encoding == "json":
        return lambda data: dict(_plain("", json.loads(data)))
    if form.message_encoding != "protobuf" or form.schema_encoding != "protobuf":
        return None
    made = class_in(form)

    def decode(data: bytes) -> Values:
        try:
            return dict(_fields("", made.FromString(data)))
        except DecodeError as error:
            raise UndecodableMessage("recording.undecodable", f"{form.schema}: {error}") from error

    return decode


def class_in(form: Format) -> Any:
    """The Protobuf class that the schema ``form`` of a file describes."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(form.data).file:
        pool.Add(file)
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
