"""Recordings of other programs are read: schemas in any order or not whole."""

from pathlib import Path

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from mcap.writer import Writer

import longreach


def recorded(directory: Path, imports: bool) -> Path:
    """A recording whose schema lists a message's own file before the one that it imports, or without that."""
    stamp = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp)
    own = descriptor_pb2.FileDescriptorProto(
        name="boom.proto", package="yard", syntax="proto3", dependency=[stamp.name]
    )
    message = own.message_type.add(name="Boom")
    message.field.add(name="at", number=1, type=11, label=1, type_name=".google.protobuf.Timestamp")
    message.field.add(name="angle", number=2, type=1, label=1)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(stamp)
    pool.Add(own)
    boom = message_factory.GetMessageClass(pool.FindMessageTypeByName("yard.Boom"))
    files = descriptor_pb2.FileDescriptorSet(file=[own, stamp] if imports else [own])
    path = directory / "boom.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("yard.Boom", "protobuf", files.SerializeToString())
        channel = writer.register_channel("/boom", "protobuf", schema)
        for k in range(5):
            data = boom(angle=0.1 * k, at={"seconds": k}).SerializeToString()
            writer.add_message(channel, 1000 + k, data, 1000 + k)
        writer.finish()
    return path


def test_schemas_list_their_files_in_any_order(tmp_path: Path) -> None:
    boom = longreach.read(recorded(tmp_path, imports=True))["/boom"]
    assert list(boom.columns) == ["at_ns", "angle"]
    assert (boom.log_ns[2], boom["at_ns"][2], boom["angle"][2]) == (1002, 2_000_000_000, 0.2)


def test_a_topic_whose_schema_lacks_a_file_is_left_out(tmp_path: Path) -> None:
    assert list(longreach.read(recorded(tmp_path, imports=False))) == []
