"""A recording as a ROS 2 bag, read with rosbags' reader and the format's own: nothing changed on the way."""

import json
import zlib
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from typer.testing import CliRunner

from plant_emulator.shell.recording import read_truth
from testbed.cli.recording import app
from testbed.recordings.merging import merge
from testbed.recordings.ros2 import to_ros2
from tests.testbed.lockstep.recorded_run import FILES, RecordedRun
from tests.testbed.recordings.editing import all_of
from vision_pc.shell.recording import vision_messages as own
from vision_pc.shell.recording import vision_recorder as topics


@pytest.fixture(scope="module")
def bag(recorded: RecordedRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("ros2")
    merge([recorded.directory / name for name in FILES], directory / "session.mcap")
    to_ros2(directory / "session.mcap", directory / "bag")
    return directory / "bag"


@pytest.fixture(scope="module")
def told(bag: Path) -> dict[str, list[tuple[int, Any]]]:
    """All messages by topic, with their times, as rosbags reads them."""
    found: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    with AnyReader([bag]) as reader:
        for connection, time_ns, data in reader.messages():
            found[connection.topic].append((time_ns, reader.deserialize(data, connection.msgtype)))
    return found


def stamp(message: Any) -> int:
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def test_pictures_come_out_to_the_last_pixel_with_their_calibration(
    recorded: RecordedRun, told: dict[str, list[tuple[int, Any]]]
) -> None:
    frames = all_of(recorded.directory / FILES[2], topics.FRAME, own.FrameMessage)
    for eye in ("left", "right"):
        pictures = [message for _, message in told[f"/camera/{eye}/image_raw"]]
        crcs = [zlib.crc32(picture.data) for picture in pictures]
        assert crcs == [getattr(frame, f"crc_{eye}") for frame in frames]
        assert [stamp(picture) for picture in pictures] == [frame.capture_ns for frame in frames]
        told_by = {stamp(info): info for _, info in told[f"/camera/{eye}/camera_info"]}
        for picture in pictures:
            info = told_by[stamp(picture)]
            assert (info.width, info.height) == (picture.width, picture.height) == (1280, 720)
            assert info.header.frame_id == picture.header.frame_id == f"camera_{eye}_optical"
            assert info.k[0] > 500.0


def test_frames_hang_together_in_one_tree(
    recorded: RecordedRun, told: dict[str, list[tuple[int, Any]]]
) -> None:
    parents = {
        each.child_frame_id: each.header.frame_id
        for name in ("/tf", "/tf_static")
        for _, message in told[name]
        for each in message.transforms
    }
    for frame in parents:
        while frame in parents:
            frame = parents[frame]
        assert frame == "world"
    drawn = {marker.header.frame_id for _, message in told["/scene"] for marker in message.markers}
    assert drawn <= set(parents)
    truths = read_truth(recorded.directory / FILES[0]).stacked("X_WT")[:, :3, 3]
    moved = [
        each.transform.translation
        for _, message in told["/tf"]
        for each in message.transforms
        if each.child_frame_id == "true/tool"
    ]
    assert np.array_equal([[p.x, p.y, p.z] for p in moved], truths)


def test_joints_have_the_names_of_the_urdf_and_the_true_ones_their_rates(
    recorded: RecordedRun, told: dict[str, list[tuple[int, Any]]]
) -> None:
    true = [message for _, message in told["/plant/joint_states"]]
    recording = read_truth(recorded.directory / FILES[0])
    assert np.array_equal([message.position for message in true], recording.stacked("q"))
    assert np.array_equal([message.velocity for message in true], recording.stacked("q_rate"))
    (_, first), *_ = told["/joint_states"]
    assert first.name == ["slew", "lift", "tilt", "wrist1", "wrist2", "wrist3"]
    assert len(first.velocity) == 0  # the controller tells none, and none is made up
    assert np.abs(first.position - true[0].position).max() < 0.01


def test_references_looks_and_log_are_there(told: dict[str, list[tuple[int, Any]]]) -> None:
    (_, path), *_ = told["/vision/path"]
    assert path.header.frame_id == path.poses[0].header.frame_id == "nominal/base"
    assert {(message.name, message.level) for _, message in told["/rosout"]} == {
        ("controller", 20),
        ("vision_pc", 20),
    }
    assert told["/vision/track"][0][1].header.frame_id == "odometry"
    texts = {marker.text for _, message in told["/scene"] for marker in message.markers}
    assert {"1", "2", "3"} <= texts


def test_the_format_s_own_reader_finds_the_same(bag: Path, told: dict[str, list[tuple[int, Any]]]) -> None:
    (file,) = bag.glob("*.mcap")
    counts: dict[str, int] = defaultdict(int)
    with file.open("rb") as stream:
        for schema, channel, _ in make_reader(stream, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            counts[channel.topic] += 1
    assert counts == {name: len(messages) for name, messages in told.items()}


def test_the_command_names_what_it_leaves_out_and_overwrites_nothing(
    recorded: RecordedRun, tmp_path: Path
) -> None:
    source, figures = str(recorded.directory / FILES[1]), tmp_path / "figures.json"
    words = ["to-ros2", source, "--out", str(tmp_path / "bag"), "--json", str(figures)]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    made = json.loads(figures.read_text())
    assert made["left_out"] == []
    assert made["written"]["/joint_states"] == made["written"]["/tf"] > 10
    again = CliRunner().invoke(app, words)
    assert isinstance(again.exception, FileExistsError)
    cut = tmp_path / "cut.mcap"
    whole = (recorded.directory / FILES[1]).read_bytes()
    cut.write_bytes(whole[: len(whole) * 3 // 4])
    damaged = to_ros2(cut, tmp_path / "cut bag")
    assert damaged.damages
    assert 0 < damaged.written["/tf"] < made["written"]["/tf"]
