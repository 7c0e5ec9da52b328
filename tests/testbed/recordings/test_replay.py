"""A recording replayed: identical, also with pictures rendered again; a flipped pixel found at its frame."""

from contextlib import closing
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from numpy.typing import NDArray

from foundation.configuration import load
from foundation.recording.decoding import RecordingUnreadable
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.faults.kinds import OwnFault
from plant_emulator.core.plant import Plant
from plant_emulator.shell.truth_recorder import TruthRecorder
from protocol.reference_messages import ReferencePose
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.rig import LockstepRig
from testbed.recordings.command import run_replay
from testbed.recordings.comparison import ReplayComparison
from testbed.recordings.perception_replay import (
    FRAME,
    LOOK,
    OBSERVATION,
    PerceptionReplay,
    pixels_for,
)
from testbed.recordings.pixels import RenderedPixels
from testbed.recordings.plant_truth import read_truth
from testbed.recordings.recorded_vision import recorded_vision
from testbed.scenarios.scenario import load_settings
from tests.plant_emulator.plant_world import plant_config
from tests.support.paths import CONFIGS
from tests.testbed.lockstep.recorded_run import FILES, RecordedRun
from tests.testbed.recordings.editing import Change, all_of, edited, kept
from vision_pc.shell.recording import vision_messages as own
from vision_pc.shell.recording import vision_recorder as topics


def replayed(path: Path, truth: Path | None = None) -> ReplayComparison:
    recording = recorded_vision(path)
    return PerceptionReplay(recording, pixels_for(recording, truth)).run()


@pytest.mark.slow("a run is replayed with every pixel")
@pytest.mark.parametrize("again", [False, True], ids=["pixels kept", "pixels rendered again"])
def test_everything_comes_out_as_recorded(recorded: RecordedRun, again: bool) -> None:
    truth = recorded.directory / FILES[0]
    compared = replayed(recorded.directory / FILES[2], truth if again else None)
    assert compared.first is None
    assert compared.exact
    assert compared.alike == compared.of
    assert compared.of[FRAME] == compared.of[OBSERVATION] > 5
    assert compared.of[LOOK] == 2


def test_without_pixels_those_of_the_same_run_are_rendered(recorded: RecordedRun, tmp_path: Path) -> None:
    """As `longreach up` lays the files out; with no plant's recording beside it, that is said."""
    source = recorded.directory / FILES[2]
    recording = recorded_vision(source)._replace(images="none")
    assert isinstance(pixels_for(recording, None), RenderedPixels)
    alone = edited(source, tmp_path / "vision.mcap", kept)
    with pytest.raises(RecordingUnreadable, match="holds no whole pictures") as refused:
        pixels_for(recorded_vision(alone)._replace(images="none"), None)
    assert refused.value.cause == "recording.no_pictures"


class Shaken(OwnFault):
    """One of your own, unknown where the recording is replayed."""

    kind: Literal["shaken"] = "shaken"

    def encoder_shift(self, elapsed_s: float) -> NDArray[np.float64]:
        return np.full(6, 0.001)


def moving_frames(directory: Path, *faults: OwnFault) -> Path:
    """A recording of frames taken while the arm moves, by a camera that shows motion."""
    scene = {"camera": {"shutter": {"kind": "rolling"}}}
    settings = load_settings(CONFIGS, {"vision": {"recording": {"images": "none"}}, "scene": scene})
    rig = LockstepRig(settings, 1, RunLog())
    with closing(rig.record_in(directory, "session 7")):
        for fault in faults:
            rig.world.plant.inject(fault)
        rig.command("enable")
        here = rig.world.states[-1].X_BT
        x, y, z = here.p_m
        rig.link.submit(ReferencePose(0, here._replace(p_m=(x, y, z - 0.1)), 1.0))
        run(watched(rig))
    return directory / FILES[2]


async def watched(rig: LockstepRig) -> None:
    async with rig.application.eyes.watch(markers=True, odometry=False) as watch:
        await watch.after(1, 5.0)


@pytest.mark.parametrize("faults", [(), (Shaken(),)], ids=["", "under a disturbance of somebody's own"])
def test_pictures_of_a_camera_that_shows_motion_are_rendered_again(
    tmp_path: Path, faults: tuple[OwnFault, ...]
) -> None:
    compared = replayed(moving_frames(tmp_path, *faults))
    assert len(read_truth(tmp_path / FILES[0]).faults) == len(faults)
    assert compared.first is None
    assert compared.alike[FRAME] == compared.of[FRAME] >= 2


def test_that_the_motion_was_not_recorded_is_said(tmp_path: Path) -> None:
    plant = Plant(plant_config(), seed=1)
    scene = load(SceneConfig, CONFIGS / "scene.yaml", {"camera": {"shutter": {"kind": "rolling"}}})
    run_of = {"scene": scene.model_dump(mode="json")}
    with closing(TruthRecorder(tmp_path / "truth.mcap", run_of)) as recorder:
        recorder.capture(plant.truth(), 1, 0)
    with pytest.raises(RecordingUnreadable, match="which is not recorded") as refused:
        RenderedPixels(tmp_path / "truth.mcap")
    assert refused.value.cause == "recording.motion_not_recorded"


def flipped(data: bytes, row: int, column: int, bit: int) -> bytes:
    image = RawImage.FromString(data)
    pixels = bytearray(image.data)
    pixels[row * image.width + column] ^= 1 << bit
    image.data = bytes(pixels)
    return bytes(image.SerializeToString())


def test_one_flipped_bit_of_one_pixel_is_found_at_its_frame(recorded: RecordedRun, tmp_path: Path) -> None:
    def change(topic: str, count: int, data: bytes) -> bytes:
        return flipped(data, 3, 5, 0) if (topic, count) == (topics.IMAGES[1], 4) else data

    path = edited(recorded.directory / FILES[2], tmp_path / "vision.mcap", change)
    compared = replayed(path)
    frames = [said.frame_id for said in all_of(path, topics.FRAME, own.FrameMessage)]
    assert (compared.first.kind, compared.first.number) == (FRAME, frames[4])
    assert "CRC-32 of the right eye's pixels: recorded '0x" in compared.first.in_words()
    assert compared.of[FRAME] - compared.alike[FRAME] == 1
    assert not run_replay(path)


def test_a_pixel_that_moves_a_corner_shows_in_the_frame_s_detections(
    recorded: RecordedRun, tmp_path: Path
) -> None:
    """Both values are told, and the checksum with it."""
    source = recorded.directory / FILES[2]
    third = all_of(source, topics.OBSERVATION, own.ObservationMessage)[2]
    column, row = (round(value) for value in third.corners_left_px[:2])

    def change(topic: str, count: int, data: bytes) -> bytes:
        if (topic, count) != (topics.IMAGES[0], 2):
            return data
        for offset in range(-3, 4):
            data = flipped(data, row + offset, column + offset, 7)
        return data

    compared = replayed(edited(source, tmp_path / "vision.mcap", change))
    assert compared.first.number == third.frame_id
    assert compared.of[OBSERVATION] > compared.alike[OBSERVATION]


def test_other_versions_are_compared_by_numbers_and_that_is_said(
    recorded: RecordedRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def nudged(topic: str, count: int, data: bytes) -> bytes:
        if (topic, count) != (topics.LOOK, 0):
            return data
        said = own.LookMessage.FromString(data)
        said.X_CM[3] += 1e-11
        said.digest = "of another machine"
        return bytes(said.SerializeToString())

    source = recorded.directory / FILES[2]
    path = edited(source, tmp_path / "vision.mcap", nudged, {"version numpy": "1.0"})
    assert run_replay(path)
    told = capsys.readouterr().out
    assert "look: 2 of 2 alike within 1e-09" in told
    assert "numpy 1.0, here" in told
    here = edited(source, tmp_path / "here.mcap", nudged)
    compared = replayed(here)
    assert compared.first.field == "X_CM[3]"


def test_a_recording_may_be_named_from_where_it_lies(
    recorded: RecordedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its own name alone has no folder in it from which those beside it were found."""
    source = recorded.directory / FILES[2]
    monkeypatch.chdir(source.parent)
    found = recorded_vision(Path(source.name))
    assert found.run == source.parent.parent
    assert pixels_for(found._replace(images="none"), None) is not None


def test_what_cannot_be_replayed_is_named(recorded: RecordedRun, tmp_path: Path) -> None:
    source = recorded.directory / FILES[2]

    def without(name: str, number: int) -> Change:
        return lambda topic, count, data: None if (topic, count) == (name, number) else data

    for number, (topic, cause) in enumerate(
        ((topics.IMAGES[0], "missing_frame"), (topics.OBSERVATION, "missing_observation"))
    ):
        path = edited(source, tmp_path / f"{number}.mcap", without(topic, 1))
        with pytest.raises(RecordingUnreadable) as refused:
            replayed(path)
        assert refused.value.cause == f"recording.{cause}"
    with pytest.raises(RecordingUnreadable) as refused:
        recorded_vision(recorded.directory / FILES[0])
    assert refused.value.cause == "recording.not_vision"


def test_a_recording_that_was_cut_off_is_replayed_as_far_as_it_goes(
    recorded: RecordedRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = (recorded.directory / FILES[2]).read_bytes()
    path = tmp_path / "vision.mcap"
    path.write_bytes(whole[: len(whole) // 2])
    assert not run_replay(path)
    told = capsys.readouterr().out
    assert "not read, at byte" in told
    assert "first difference" not in told
