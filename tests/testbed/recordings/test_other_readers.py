"""What other programs make of a run's recordings: by the rules of one viewer, and by another's own reader.

Lichtblick, an open successor of Foxglove Studio, tells in `packages/mcap-support` what it refuses: a schema
that does not hold all that it names, repeated bytes, kinds of numbers that it does not know, times beyond
2^53 s. Its earlier versions did not come back from a message that holds its own kind.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from google.protobuf import descriptor_pb2
from google.protobuf.descriptor import FieldDescriptor

from foundation.recording.contents import contents
from foundation.recording.decoding import class_in, messages
from foundation.recording.mcap_file import Format
from tests.testbed.lockstep.recorded_run import FILES, RecordedRun

_SCALARS = {
    getattr(FieldDescriptor, f"TYPE_{name}")
    for name in (
        "DOUBLE", "FLOAT", "INT32", "SINT32", "SFIXED32", "UINT32", "FIXED32", "INT64", "SINT64", "SFIXED64",
        "UINT64", "FIXED64", "BOOL", "STRING", "BYTES", "ENUM",
    )
}  # fmt: skip
_STAMP = "google.protobuf.Timestamp"


@pytest.fixture(scope="module")
def files(recorded: RecordedRun) -> dict[str, Path]:
    """All three recordings of a run by name."""
    return {Path(name).name: recorded.directory / name for name in FILES}


def refused(form: Format) -> list[str]:
    """Why the viewer would refuse a channel of such messages."""
    if (form.message_encoding, form.schema_encoding) != ("protobuf", "protobuf"):
        return [f"{form.message_encoding} in {form.schema_encoding}"]
    described = descriptor_pb2.FileDescriptorSet.FromString(form.data)
    whole = {file.name for file in described.file}
    missing = [name for file in described.file for name in file.dependency if name not in whole]
    if missing:
        return [f"not in the schema: {name}" for name in missing]
    return list(_refused_in(class_in(form).DESCRIPTOR, ()))


def _refused_in(kind: Any, above: tuple[str, ...]) -> Iterator[str]:
    if kind.full_name in above:
        yield f"{kind.full_name} holds itself"
        return
    for field in kind.fields:
        if field.message_type is not None:
            yield from _refused_in(field.message_type, (*above, kind.full_name))
        elif field.type not in _SCALARS:
            yield f"{kind.full_name}.{field.name}: no scalar that is known"
        elif field.type == FieldDescriptor.TYPE_BYTES and field.is_repeated:
            yield f"{kind.full_name}.{field.name}: repeated bytes"


@pytest.mark.parametrize("name", [Path(name).name for name in FILES])
def test_every_schema_keeps_the_viewer_s_rules(files: dict[str, Path], name: str) -> None:
    found = contents(files[name])
    assert {
        topic.name: refused(topic.format) for topic in found.topics.values() if refused(topic.format)
    } == {}
    assert len(found.topics) >= 3
    assert all(".".join(topic.format.schema.split(".")[:-1]) for topic in found.topics.values())


@pytest.mark.parametrize("name", [Path(name).name for name in FILES])
def test_all_stamps_are_times_that_the_viewer_reads(files: dict[str, Path], name: str) -> None:
    found = contents(files[name])
    classes = {topic.name: class_in(topic.format) for topic in found.topics.values()}
    stamps = [
        stamp
        for topic, record in messages(files[name], classes)
        for stamp in _stamps(classes[topic].FromString(record.data))
    ]
    assert len(stamps) > 5
    assert all(0 <= stamp.seconds < 2**53 and 0 <= stamp.nanos < 10**9 for stamp in stamps)


def _stamps(message: Any) -> Iterator[Any]:
    for field, value in message.ListFields():
        if field.message_type is not None:
            for each in value if field.is_repeated else [value]:
                if field.message_type.full_name == _STAMP:
                    yield each
                else:
                    yield from _stamps(each)
