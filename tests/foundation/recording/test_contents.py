"""What is left of a cut or damaged recording is found and told."""

from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from foundation.recording.contents import contents
from foundation.recording.decoding import RecordingUnreadable, messages
from tests.foundation.recording.test_mcap_file import written


def test_of_a_cut_file_all_up_to_the_cut_is_counted(tmp_path: Path) -> None:
    written(tmp_path / "f.mcap", 40)
    whole = (tmp_path / "f.mcap").read_bytes()
    counts = []
    for cut in range(300, len(whole), 199):
        (tmp_path / "cut.mcap").write_bytes(whole[:cut])
        found = contents(tmp_path / "cut.mcap")
        assert not found.complete
        counts.append(found.messages)
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (0, 40)


def test_a_damaged_chunk_is_told_and_the_others_are_read(tmp_path: Path) -> None:
    written(tmp_path / "f.mcap", 40)
    with (tmp_path / "f.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    second = summary.chunk_indexes[1]
    whole = bytearray((tmp_path / "f.mcap").read_bytes())
    whole[second.chunk_start_offset + second.chunk_length - 10] ^= 0x10
    (tmp_path / "f.mcap").write_bytes(whole)
    found = contents(tmp_path / "f.mcap")
    (damage,) = found.damages
    assert damage.offset == second.chunk_start_offset
    assert damage.what.startswith("damaged chunk")
    times = [record.publish_time for _, record in messages(tmp_path / "f.mcap", ("/a", "/c"))]
    assert times == [*range(10), *range(20, 40)]


def test_a_bad_checksum_is_told(tmp_path: Path) -> None:
    """Of a chunk that unpacks well, but not to what was written."""
    written(tmp_path / "f.mcap", 4)
    with (tmp_path / "f.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    whole = bytearray((tmp_path / "f.mcap").read_bytes())
    whole[summary.chunk_indexes[0].chunk_start_offset + 9 + 24] ^= 1  # behind two times and the size
    (tmp_path / "f.mcap").write_bytes(whole)
    (damage,) = contents(tmp_path / "f.mcap").damages
    assert "crc" in damage.what


@pytest.mark.parametrize("compression", list(CompressionType))
def test_files_of_others_are_read(tmp_path: Path, compression: CompressionType) -> None:
    with (tmp_path / "f.mcap").open("wb") as stream:
        writer = Writer(stream, compression=compression)
        writer.start()
        schema = writer.register_schema("x", "ros2msg", b"int32 a")
        channels = [
            writer.register_channel("/x", "cdr", schema, {"qos": "best"}),
            writer.register_channel("/y", "bytes", 0),
        ]
        for number in range(10):
            writer.add_message(channels[number % 2], number, bytes([number]), number)
        writer.finish()
    found = contents(tmp_path / "f.mcap")
    assert {topic.name: topic.format.schema for topic in found.topics.values()} == {"/x": "x", "/y": ""}
    assert (found.messages, found.complete) == (10, True)
    assert [record.data for _, record in messages(tmp_path / "f.mcap", ("/x",))][:2] == [b"\0", b"\2"]


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "other.txt").write_bytes(b"not an MCAP file at all")
    with pytest.raises(RecordingUnreadable, match=r"other\.txt") as refused:
        contents(tmp_path / "other.txt")
    assert refused.value.cause == "recording.no_recording"
