"""The file: other readers find everything, a kill leaves whole chunks."""

import resource
import struct
from contextlib import closing
from pathlib import Path

import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from foundation.recording.mcap_file import CHUNK_NS, Format, McapFile, Topic

TEXT = Format("longreach.Text", "jsonschema", b'{"type": "object"}', "json")
TOPICS = (
    Topic("/a", TEXT, str.encode),
    Topic("/b", TEXT, str.encode),
    Topic("/c", Format("longreach.Other", "", b"", "bytes"), bytes),
)


def made(path: Path) -> McapFile:
    """A new recording of the three topics."""
    return McapFile(path, TOPICS, {"run": {"session": "7"}, "host": {}})


def written(path: Path, count: int = 100, step_ns: int = CHUNK_NS // 10) -> None:
    """A closed recording of ``count`` messages, three of four on /a."""
    with closing(made(path)) as file:
        for number in range(count):
            topic = 0 if number % 4 else 2
            file.add(topic, f"{number}" if topic == 0 else bytes([number]), number * step_ns, number)


def kept(data: bytes, path: Path) -> list[int]:
    """Publishing times of all messages that a stream reader finds in ``data`` before it ends or is cut."""
    path.write_bytes(data)
    found = []
    with path.open("rb") as stream:
        try:
            records = StreamReader(stream, validate_crcs=True).records
            found.extend(record.publish_time for record in records if isinstance(record, Message))
        except (McapError, struct.error):
            pass
    return found


def test_the_library_finds_everything_by_its_index(tmp_path: Path) -> None:
    written(tmp_path / "f.mcap")
    with (tmp_path / "f.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = [
            (channel.topic, m.log_time, m.publish_time, m.data) for _, channel, m in reader.iter_messages()
        ]
        only = [m.publish_time for _, _, m in reader.iter_messages("/c", starting_at=20 * CHUNK_NS // 10)]
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        summary = reader.get_summary()
    assert found == [
        ("/a", n * CHUNK_NS // 10, n, f"{n}".encode()) if n % 4 else ("/c", n * CHUNK_NS // 10, n, bytes([n]))
        for n in range(100)
    ]
    assert only == list(range(20, 100, 4))
    assert metadata == {"run": {"session": "7"}, "host": {}}
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.channel_message_counts == {1: 75, 3: 25}
    assert summary.statistics.message_end_time == 99 * CHUNK_NS // 10
    assert [schema.name for schema in summary.schemas.values()] == ["longreach.Text", "longreach.Other"]
    assert [summary.schemas[c.schema_id].name for c in summary.channels.values()][1] == "longreach.Text"
    assert len(summary.chunk_indexes) == 10


def test_a_kill_at_any_time_takes_along_less_than_a_chunk(tmp_path: Path) -> None:
    path, copy, step_ns = tmp_path / "f.mcap", tmp_path / "copy.mcap", CHUNK_NS // 7
    with closing(made(path)) as file:
        for number in range(30):
            file.add(0, f"{number}", number * step_ns, number)
            found = kept(path.read_bytes(), copy)
            assert found == list(range(len(found)))
            assert (number - len(found)) * step_ns < CHUNK_NS


def test_what_a_full_disk_takes_of_a_chunk_is_taken_back(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    file = made(path)
    file.add(0, "first", 0, 0)
    file.flush()
    size, limits = path.stat().st_size, resource.getrlimit(resource.RLIMIT_FSIZE)
    file.add(0, "second", 1, 1)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + 50, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            file.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.stat().st_size == size
    assert kept(path.read_bytes(), tmp_path / "copy.mcap") == [0]


def test_an_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "f.mcap").write_bytes(b"precious")
    with pytest.raises(FileExistsError):
        made(tmp_path / "f.mcap")
    assert (tmp_path / "f.mcap").read_bytes() == b"precious"
