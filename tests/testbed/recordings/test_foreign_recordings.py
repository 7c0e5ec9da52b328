"""Recordings of other programs become tables: names that collide, schemas in any order or not whole."""

import json
from pathlib import Path

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from mcap.writer import Writer
from typer.testing import CliRunner

from testbed.cli.main import app
from testbed.recordings.comparison import table_names, write_tables


def test_topics_that_a_file_name_cannot_tell_apart_get_names_of_their_own(tmp_path: Path) -> None:
    source = tmp_path / "two.mcap"
    with source.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("Any", "jsonschema", b'{"type": "object"}')
        for topic, count in (("/arm/state", 5), ("/arm_state", 7)):
            channel = writer.register_channel(topic, "json", schema)
            for k in range(count):
                writer.add_message(channel, 1000 + k, json.dumps({"k": k}).encode(), 1000 + k)
        writer.finish()
    done = CliRunner().invoke(app, ["recording", "to-csv", str(source), "--out", str(tmp_path / "T")])
    assert done.exit_code == 0, done.output
    said = " ".join(done.output.split())
    assert "arm_state.csv: 5 rows of /arm/state" in said
    assert "arm_state_2.csv: 7 rows of /arm_state" in said
    lengths = {path.name: len(path.read_text().splitlines()) - 1 for path in (tmp_path / "T").iterdir()}
    assert lengths == {"arm_state.csv": 5, "arm_state_2.csv": 7}


def test_no_two_names_are_alike() -> None:
    topics = dict(enumerate(["/a/b", "a_b", "/A/B", "/a_b_2", "/", "a:b", "../x", "y" * 300]))
    names = list(table_names(topics).values())
    assert names[:5] == ["a_b.csv", "a_b_2.csv", "A_B_3.csv", "a_b_2_2.csv", "topic.csv"]
    assert len({name.lower() for name in names}) == len(names)
    assert max(map(len, names)) < 255
    assert not any("/" in name or name.startswith(".") for name in names)


def test_nothing_is_written_where_a_table_is_there(tmp_path: Path) -> None:
    source = recorded(tmp_path, imports=True)
    (tmp_path / "T").mkdir()
    (tmp_path / "T" / "boom.csv").write_text("mine")
    with pytest.raises(FileExistsError, match=r"boom\.csv"):
        write_tables(source, tmp_path / "T")
    assert [path.read_text() for path in (tmp_path / "T").iterdir()] == ["mine"]


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
    tables, left_out = write_tables(recorded(tmp_path, imports=True), tmp_path / "T")
    assert (tables["boom.csv"].rows, left_out) == (5, [])
    lines = (tmp_path / "T" / "boom.csv").read_text().splitlines()
    assert lines[0] == "log_time_ns,publish_time_ns,at_ns,angle"
    assert lines[3] == "1002,1002,2000000000,0.2"


def test_a_topic_whose_schema_lacks_a_file_is_left_out_by_name(tmp_path: Path) -> None:
    assert write_tables(recorded(tmp_path, imports=False), tmp_path / "T") == ({}, ["/boom"])
