"""Messages made from a table, and by well-known schemas: what others decode is what was put in."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf import descriptor_pb2
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from foundation.recording.decoding import UndecodableMessage, decoder
from foundation.recording.mcap_file import Format, McapFile, Topic
from foundation.recording.messages import (
    MessageField,
    PosedFrame,
    format_of,
    log_line,
    message_class,
    transforms,
)

Reading = message_class(
    "Reading",
    (
        MessageField("level_m"),
        MessageField("count", "int64"),
        MessageField("name", "string"),
        MessageField("valid", "bool"),
        MessageField("row", repeated=True),
        MessageField("names", "string", repeated=True),
    ),
)


def test_another_decoder_reads_every_value_to_the_last_bit(tmp_path: Path) -> None:
    values = {"level_m": 0.1 + 0.2, "count": -(2**62), "name": "Ö", "row": [1e-308, -0.0, 7.0]}
    with closing(McapFile(tmp_path / "f.mcap", [Topic("/r", format_of(Reading), bytes)], {})) as file:
        file.add(0, Reading(**values).SerializeToString(), 1, 1)
    with (tmp_path / "f.mcap").open("rb") as stream:
        ((_, _, _, said),) = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
    assert {name: getattr(said, name) for name in values} == values
    assert np.signbit(said.row[1])
    assert not said.HasField("valid")


def test_zero_is_not_absence() -> None:
    decode = decoder(format_of(Reading))
    assert decode is not None
    assert decode(Reading(level_m=0.0).SerializeToString()) == {"level_m": 0.0}
    assert decode(b"") == {}
    with pytest.raises(UndecodableMessage, match=r"longreach\.Reading"):
        decode(b"\xff\xff")


def test_a_schema_holds_every_file_that_it_needs_before_it_is_needed() -> None:
    """As readers add them to a pool one by one."""
    files = descriptor_pb2.FileDescriptorSet.FromString(format_of(SceneUpdate).data).file
    seen: set[str] = set()
    for file in files:
        assert set(file.dependency) <= seen
        seen.add(file.name)
    assert "foxglove/SceneEntity.proto" in seen


def test_transforms_are_the_poses_that_were_given() -> None:
    generator = np.random.default_rng(5)
    frames = []
    for number in range(4):
        X = np.eye(4)
        X[:3, :3] = Rotation.random(rng=generator).as_matrix()
        X[:3, 3] = generator.standard_normal(3)
        frames.append(PosedFrame("world", f"f{number}", X))
    said = FrameTransforms.FromString(transforms(frames, 3_000_000_007))
    for frame, found in zip(frames, said.transforms, strict=True):
        q, p = found.rotation, found.translation
        assert (found.parent_frame_id, found.child_frame_id) == ("world", frame.child)
        np.testing.assert_allclose(
            Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), frame.X[:3, :3], atol=1e-12
        )
        assert [p.x, p.y, p.z] == frame.X[:3, 3].tolist()
        assert (found.timestamp.seconds, found.timestamp.nanos) == (3, 7)


def test_lines_and_json_are_decoded_flat() -> None:
    from foxglove_schemas_protobuf.Log_pb2 import Log

    decode = decoder(format_of(Log))
    assert decode is not None
    line = decode(log_line(5, "warning", "plant", "it broke"))
    assert (line["timestamp_ns"], line["level"], line["message"]) == (5, Log.Level.WARNING, "it broke")
    plain = decoder(Format("x", "jsonschema", b"{}", "json"))
    assert plain is not None
    assert plain(b'{"a": [1, {"b": null, "c": 2}]}') == {"a[0]": 1, "a[1].c": 2}
    for wrong in (b"", b'{"a":', b'{"a": "\xff"}', b'{"a": ' + b"9" * 5000 + b"}", b"[" * 100_000):
        with pytest.raises(UndecodableMessage, match=r"x: b'.{0,60}' is no JSON in UTF-8"):
            plain(wrong)
    assert decoder(Format("x", "ros2msg", b"", "cdr")) is None
