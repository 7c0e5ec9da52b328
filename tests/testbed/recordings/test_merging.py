"""One clock for all: the offsets of lockstep are found, stamps moved, another session's files refused."""

import json
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from foundation.recording.decoding import RecordingUnreadable
from testbed.lockstep.world import CONTROLLER_CLOCK_NS, VISION_CLOCK_NS
from testbed.recordings.merging import CONTROLLER, JOINTS, PLANT, VISION, fitted_clock, merge
from tests.testbed.lockstep.recorded_run import FILES, RecordedRun
from tests.testbed.recordings.test_replay import edited, kept


@pytest.fixture(scope="module")
def merged(recorded: RecordedRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("merged") / "session.mcap"
    (target.parent / "arm.urdf").write_text("<robot/>")
    files = [recorded.directory / name for name in FILES]
    clocks = merge(files, target, [target.parent / "arm.urdf"])
    assert clocks[VISION].offset_ns == 0
    assert (clocks[PLANT].offset_ns, clocks[PLANT].uncertainty_ns) == (VISION_CLOCK_NS, 0)
    controller = clocks[CONTROLLER]
    wrong_ns = abs(controller.offset_ns - (VISION_CLOCK_NS - CONTROLLER_CLOCK_NS))
    assert wrong_ns <= controller.uncertainty_ns < 10_000_000
    return target


def messages(path: Path) -> list[tuple[str, int, Any]]:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [(channel.topic, m.log_time, said) for _, channel, m, said in reader.iter_decoded_messages()]


def test_frames_and_captures_are_at_the_same_time(merged: Path) -> None:
    """The instant at which the plant took a frame is the one at which vision says that it was taken."""
    said = messages(merged)
    captures = {each.frame_id: log_ns for topic, log_ns, each in said if topic == "/plant/capture"}
    frames = {each.frame_id: each.capture_ns for topic, _, each in said if topic == "/vision/frame"}
    assert len(frames) > 5
    assert all(captures[number] == capture_ns for number, capture_ns in frames.items())


def test_every_stamp_of_a_well_known_message_is_on_the_common_clock(merged: Path) -> None:
    for topic, log_ns, said in messages(merged):
        if topic in ("/tf_true", "/tf", JOINTS):
            for each in said.transforms:
                assert each.timestamp.seconds * 10**9 + each.timestamp.nanos == log_ns


def test_all_frames_are_of_one_tree(merged: Path) -> None:
    parents: dict[str, str] = {}
    for topic, _, said in messages(merged):
        if topic in ("/tf_true", "/tf", "/vision/tf", JOINTS):
            parents |= {each.child_frame_id: each.parent_frame_id for each in said.transforms}
    for frame in ("seen/object", "nominal/tool", "true/tool", "nominal/base"):
        while frame in parents:
            frame = parents[frame]
        assert frame == "world"


def test_metadata_and_attachments_are_those_of_all_parts(merged: Path) -> None:
    with merged.open("rb") as stream:
        reader = make_reader(stream)
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        attached = {each.name: each.data for each in reader.iter_attachments()}
    assert metadata["session"] == {"id": "session 7", "service": "merged", "clock": VISION}
    assert int(metadata["plant_emulator clock"]["offset_ns"]) == VISION_CLOCK_NS
    assert "vision" in json.loads(metadata["vision_pc run"]["configuration"])
    assert attached["arm.urdf"] == b"<robot/>"


def test_a_drifting_clock_is_followed_and_its_uncertainty_told() -> None:
    """20 ppm over a minute, with 30 µs of noise at most and a bound of 100 µs that each sample has."""
    noise = (0, 30_000, -30_000, 12_000, -7_000, 5_000)
    samples = []
    for number in range(61):
        time_ns = 10**15 + number * 10**9
        samples.append((time_ns, -5 * 10**12 + 20_000 * number + noise[number % 6], 100_000))
    clock = fitted_clock(samples)
    for number in (0, 30, 60):
        time_ns = 10**15 + number * 10**9
        truth_ns = time_ns - 5 * 10**12 + 20_000 * number
        assert abs(clock.on_vision(time_ns) - truth_ns) < 15_000
    assert clock.drift_ppm == pytest.approx(20.0, abs=0.3)
    assert 100_000 < clock.uncertainty_ns < 145_000


def test_what_does_not_belong_together_is_refused(recorded: RecordedRun, tmp_path: Path) -> None:
    plant, controller, vision = (recorded.directory / name for name in FILES)
    other = edited(controller, tmp_path / "other.mcap", kept, {"id": "session 8"})
    cases = [
        ([plant, other, vision], "recording.other_session"),
        ([plant, controller], "recording.not_vision"),
        ([plant, plant, vision], "recording.twice"),
    ]
    silent = edited(vision, tmp_path / "silent.mcap", lambda topic, _, data: None)
    cases.append(([controller, silent], "recording.no_clock"))
    for files, cause in cases:
        with pytest.raises(RecordingUnreadable) as refused:
            merge(files, tmp_path / "session.mcap")
        assert refused.value.cause == cause
        assert not (tmp_path / "session.mcap").exists()
