"""What is left of a cut or damaged recording is found, told, and made whole again."""

from contextlib import closing
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Attachment
from mcap.writer import CompressionType, Writer

from foundation.recording.decoding import RecordingUnreadable
from foundation.recording.mcap_file import CHUNK_NS, McapFile
from foundation.recording.recovery import contents, recover
from tests.foundation.recording.test_mcap_file import TOPICS, kept, written

HEAD = Attachment(create_time=0, log_time=0, name="arm.urdf", media_type="text/xml", data=b"<robot/>")


def test_a_whole_file_comes_out_as_it_went_in(tmp_path: Path) -> None:
    with closing(McapFile(tmp_path / "f.mcap", TOPICS, {"run": {"a": "b"}}, [HEAD])) as file:
        for number in range(30):
            file.add(number % 3 // 2 * 2, "x" if number % 3 < 2 else b"y", number * CHUNK_NS // 9, number)
    found = recover(tmp_path / "f.mcap", tmp_path / "g.mcap")
    assert (found.messages, found.complete, found.damages, found.stray) == (30, True, (), 0)
    assert (tmp_path / "f.mcap").read_bytes() == (tmp_path / "g.mcap").read_bytes()
    with (tmp_path / "g.mcap").open("rb") as stream:
        (attached,) = make_reader(stream).iter_attachments()
    assert attached == HEAD


def test_a_cut_file_is_made_whole(tmp_path: Path) -> None:
    written(tmp_path / "f.mcap", 40)
    whole = (tmp_path / "f.mcap").read_bytes()
    counts = []
    for number, cut in enumerate(range(300, len(whole), 199)):
        (tmp_path / "cut.mcap").write_bytes(whole[:cut])
        found = recover(tmp_path / "cut.mcap", target := tmp_path / f"{number}.mcap")
        assert not found.complete
        again = contents(target)
        assert (again.complete, again.damages, again.counts) == (True, (), found.counts)
        with target.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            assert [m.publish_time for _, _, m in reader.iter_messages()] == list(range(found.messages))
        counts.append(found.messages)
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (0, 40)


def test_a_damaged_chunk_is_told_and_the_others_are_kept(tmp_path: Path) -> None:
    written(tmp_path / "f.mcap", 40)
    with (tmp_path / "f.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    second = summary.chunk_indexes[1]
    whole = bytearray((tmp_path / "f.mcap").read_bytes())
    whole[second.chunk_start_offset + second.chunk_length - 10] ^= 0x10
    (tmp_path / "f.mcap").write_bytes(whole)
    found = recover(tmp_path / "f.mcap", tmp_path / "g.mcap")
    (damage,) = found.damages
    assert damage.offset == second.chunk_start_offset
    assert damage.what.startswith("damaged chunk")
    times = kept((tmp_path / "g.mcap").read_bytes(), tmp_path / "copy.mcap")
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
    assert "checksum" in damage.what


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
    recover(tmp_path / "f.mcap", tmp_path / "g.mcap")
    with (tmp_path / "g.mcap").open("rb") as stream:
        found = [
            (s and s.name, c.topic, c.metadata, m.data) for s, c, m in make_reader(stream).iter_messages()
        ]
    assert found[:2] == [("x", "/x", {"qos": "best"}, b"\0"), (None, "/y", {}, b"\1")]
    assert len(found) == 10


def test_what_is_no_recording_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "other.txt").write_bytes(b"not an MCAP file at all")
    with pytest.raises(RecordingUnreadable, match=r"other\.txt") as refused:
        recover(tmp_path / "other.txt", tmp_path / "g.mcap")
    assert refused.value.cause == "recording.no_recording"
    assert not (tmp_path / "g.mcap").exists()
