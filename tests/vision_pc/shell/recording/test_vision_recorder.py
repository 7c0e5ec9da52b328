"""The recorder: numbered observations, a bound on waiting pixels, pictures as wanted, a failure told."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from foundation.configuration import load
from foundation.recording.mcap_file import Entries, Topic
from tests.support.paths import CONFIGS
from vision_pc.config.vision import VisionConfig
from vision_pc.core.types import CameraErrors, FrameObservation, Look, StereoPair
from vision_pc.shell.recording import vision_recorder as names
from vision_pc.shell.recording.vision_messages import LookMessage, ObservationMessage, OdometryMessage
from vision_pc.shell.recording.vision_recorder import WAITING_FRAMES, VisionRecorder

CONFIG = load(VisionConfig, CONFIGS / "vision.yaml")
PERIOD_NS = 100_000_000


class HeldSink:
    """A sink that keeps what is put; ``take`` encodes all that waits, as the thread would."""

    def __init__(self, path: Path, topics: Sequence[Topic], metadata: Entries) -> None:
        self.path, self.topics, self.metadata = path, topics, metadata
        self.failure, self.dropped, self.written = "", 0, 0
        self.waiting: list[tuple[int, Any]] = []

    def wants(self, topic: int) -> bool:
        return True

    def put(self, topic: int, message: Any, log_ns: int, publish_ns: int, *, wanted: bool = False) -> None:
        self.waiting.append((topic, message))

    def take(self) -> dict[str, list[bytes]]:
        found: dict[str, list[bytes]] = {}
        for topic, message in self.waiting:
            found.setdefault(self.topics[topic].name, []).append(self.topics[topic].encode(message))
        self.waiting.clear()
        return found

    def close(self) -> None:
        pass


def recorder(**settings: Any) -> tuple[VisionRecorder, HeldSink]:
    """A recorder of pictures as ``settings`` want them, and its sink."""
    recording = CONFIG.recording.model_copy(update=settings)
    config = CONFIG.model_copy(update={"recording": recording})
    made = VisionRecorder(Path("vision.mcap"), config, {}, {}, lambda: 5, HeldSink)
    assert isinstance(made.sink, HeldSink)
    return made, made.sink


def pair(number: int) -> StereoPair:
    picture = np.full((48, 64), number % 250, dtype=np.uint8)
    return StereoPair(picture, picture + 1, number * PERIOD_NS, number)


def seen(number: int) -> FrameObservation:
    """A frame that shows the tool."""
    X_CM = np.eye(4)
    X_CM[2, 3] = number
    frame = pair(number)
    nothing: Any = dict.fromkeys(("cov_CM", "bias_CM", "X_CO", "cov_CO", "bias_CO", "offset"))
    return FrameObservation(frame.capture_ns, number, X_CM, markers=(), rejected={}, **nothing)


def test_an_observation_says_from_which_one_it_went_on_and_whether_that_was_corrected() -> None:
    made, sink = recorder()
    first, second = seen(1), seen(2)
    made.observed(pair(1), None, first)
    made.observed(pair(2), first, second)
    errors = CameraErrors(np.zeros(12), np.eye(12))
    made.observed(pair(3), second._replace(errors=errors), seen(3))
    made.observed(pair(4), seen(9), seen(4))
    said = [ObservationMessage.FromString(data) for data in sink.take()[names.OBSERVATION]]
    before = [each.previous if each.HasField("previous") else None for each in said]
    told = [(each.number, number, each.corrected) for each, number in zip(said, before, strict=True)]
    assert told == [(1, None, False), (2, 1, False), (3, 2, True), (4, -1, False)]
    assert said[0].p_CM_z_m == 1.0
    assert not said[0].HasField("p_CO_x_m")
    assert len({each.digest for each in said}) == 4


def test_a_frame_is_kept_once_and_no_more_than_some_wait() -> None:
    made, sink = recorder(images="raw")
    for number in range(1, WAITING_FRAMES + 4):
        made.observed(pair(number), None, seen(number))
        made.tracked(1, pair(number), False, np.eye(4) if number == 2 else None, "no_texture")
    assert made.missed == 3
    taken = sink.take()
    assert len(taken[names.FRAME]) == len(taken[names.IMAGES[0]]) == WAITING_FRAMES
    assert len(taken[names.OBSERVATION]) == len(taken[names.ODOMETRY]) == WAITING_FRAMES + 3
    states = [list(OdometryMessage.FromString(data).X_BT) for data in taken[names.ODOMETRY]]
    assert states[1] == np.eye(4).ravel().tolist()
    assert states[0] == states[2] == []
    made.observed(pair(99), None, seen(99))
    assert made.counts()["frames_missed"] == 3
    assert len(sink.take()[names.FRAME]) == 1


@pytest.mark.parametrize(("images", "kept"), [("none", 0), ("jpeg", 3), ("raw", 21)])
def test_pictures_come_as_often_as_wanted(images: str, kept: int) -> None:
    made, sink = recorder(images=images)
    found: list[bytes] = []
    for number in range(1, 22):
        made.observed(pair(number), None, seen(number))
        found += sink.take().get(names.IMAGES[0], [])
    assert len(found) == kept
    if images == "jpeg":
        said = CompressedImage.FromString(found[1])
        shown = cv2.imdecode(np.frombuffer(said.data, np.uint8), cv2.IMREAD_GRAYSCALE)
        assert shown is not None
        assert abs(int(shown.mean()) - 11) <= 1
        assert said.timestamp.seconds == 1


def test_a_disk_that_takes_nothing_more_is_told_once() -> None:
    made, sink = recorder()
    told: list[str] = []
    made.failed = told.append
    made.event("first", "info", {})
    sink.failure = "No space left on device"
    made.event("second", "info", {"a": 1})
    made.event("third", "info", {})
    assert told == ["vision.mcap: No space left on device"]


def test_a_look_names_every_observation_that_it_is_made_of() -> None:
    """Also one of a thousand frames, the most that a look may take."""
    made, sink = recorder()
    found = [seen(number) for number in range(1000)]
    for number, observation in enumerate(found):
        made.observed(pair(number), found[number - 1] if number else None, observation)
    look: Any = dict.fromkeys(Look._fields, None) | {"time_ns": 5, "X_CM": np.eye(4), "X_CO": np.eye(4)}
    made.looked(Look(**look), found)
    (written,) = sink.take()[names.LOOK]
    assert list(LookMessage.FromString(written).observations) == list(range(1, 1001))
