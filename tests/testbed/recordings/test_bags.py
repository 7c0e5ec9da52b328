"""ROS bags of stereo pictures: read into directories that odometry, camera check and hand-eye take."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from foundation.configuration import load
from plant_emulator.config.scene import SceneConfig
from testbed.camera.pairs import marker_pairs, take
from tests.support.commands import ran
from tests.support.paths import CONFIGS
from vision_pc.config.vision import VisionConfig
from vision_pc.core.types import Image, StereoPair
from vision_pc.shell.cameras.picture_files import pictures_in
from vision_pc.shell.cameras.sequence import Recorded, follow, read_pairs

STORE = get_typestore(Stores.ROS2_KILTED)
TYPES = STORE.types
LEFT, RIGHT = "/camera/left/image_raw", "/camera/right/image_raw"
START_NS, PERIOD_NS = 1_700_000_000_000_000_000, 100_000_000
FX, BASELINE_M = 530.0, 0.12


@pytest.fixture(scope="module")
def pairs() -> list[StereoPair]:
    return marker_pairs(load(SceneConfig, CONFIGS / "scene.yaml"), 4, 1)


def header(at_ns: int) -> Any:
    stamp = TYPES["builtin_interfaces/msg/Time"](*divmod(at_ns, 10**9))
    return TYPES["std_msgs/msg/Header"](stamp, "camera_left_optical")


def raw(picture: Image, at_ns: int, encoding: str = "mono8") -> Any:
    height, width = picture.shape[:2]
    step = picture.size // height
    return TYPES["sensor_msgs/msg/Image"](header(at_ns), height, width, encoding, 0, step, picture.ravel())


def compressed(picture: Image, at_ns: int) -> Any:
    _, data = cv2.imencode(".png", picture)
    return TYPES["sensor_msgs/msg/CompressedImage"](header(at_ns), "png", data.ravel())


def info(at_ns: int, right: bool, d: float = 0.0) -> Any:
    p = np.array([FX, 0, 639.5, -FX * BASELINE_M * right, 0, FX, 359.5, 0, 0, 0, 1, 0], dtype=float)
    region = TYPES["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    k, eye = p.reshape(3, 4)[:, :3].ravel(), np.eye(3).ravel()
    made = TYPES["sensor_msgs/msg/CameraInfo"]
    return made(header(at_ns), 720, 1280, "plumb_bob", np.full(5, d), k, eye, p, 0, 0, region)


Said = tuple[str, Any, int]


def bag(folder: Path, said: Sequence[Said], plugin: StoragePlugin = StoragePlugin.MCAP) -> Path:
    path = folder / "bag"
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for topic, message, at_ns in said:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], at_ns, STORE.serialize_cdr(message, kind))
    return path


def stereo(pairs: Sequence[StereoPair], made: Any = raw, late_ns: int = 0) -> Iterator[Said]:
    for k, pair in enumerate(pairs):
        at_ns = START_NS + k * PERIOD_NS
        yield LEFT, made(pair.left, at_ns), at_ns
        yield RIGHT, made(pair.right, at_ns + late_ns), at_ns
        yield "/camera/left/camera_info", info(at_ns, False), at_ns
        yield "/camera/right/camera_info", info(at_ns, True), at_ns


def read(path: Path, to: Path, *options: str, status: int = 0) -> str:
    """What is printed of it in one line."""
    done = ran("recording", "pictures", path, "--out", to, *options, status=status)
    return done.output.replace("\n", " ")


@pytest.mark.slow("pictures are rendered, and odometry follows them")
@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_odometry_camera_check_and_hand_eye_read_what_was_in_the_bag(
    pairs: list[StereoPair], plugin: StoragePlugin, tmp_path: Path
) -> None:
    to = tmp_path / "pictures"
    done = read(bag(tmp_path, list(stereo(pairs)), plugin), to)
    assert f"4 pairs of {LEFT} and {RIGHT}" in done
    recorded = Recorded(to / "left", to / "right", to / "calibration.yaml")
    found = [pair for pair in read_pairs(recorded.files()) if isinstance(pair, StereoPair)]
    assert [pair.capture_ns for pair in found] == [START_NS + k * PERIOD_NS for k in range(4)]
    for pair, own in zip(found, pairs, strict=True):
        assert np.array_equal(pair.left, own.left)
        assert np.array_equal(pair.right, own.right)
    config = load(VisionConfig, CONFIGS / "vision.yaml")
    followed = follow(recorded, config)
    assert followed.lost == 0
    assert f"baseline {BASELINE_M:.4f} m" in " ".join(followed.notes)
    assert np.array_equal(take(str(to), config.camera, 10).pairs[0].left, pairs[0].left)
    assert len(pictures_in(to / "left")) == 4


def colours(picture: Image, at_ns: int) -> Any:
    return raw(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR), at_ns, "bgr8")


@pytest.mark.parametrize("made", [compressed, colours])
def test_compressed_and_coloured_pictures_are_read(
    pairs: list[StereoPair], made: Any, tmp_path: Path
) -> None:
    read(bag(tmp_path, list(stereo(pairs[:1], made))), tmp_path / "to")
    (picture,) = pictures_in(tmp_path / "to" / "right")
    assert np.array_equal(cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE), pairs[0].right)


def small(topic: str, at_ns: int = START_NS, encoding: str = "mono8") -> Said:
    return topic, raw(np.full((8, 10), 100, dtype=np.uint8), at_ns, encoding), START_NS


ONE, OTHER = small(LEFT), small(RIGHT)
WRONG: dict[str, tuple[list[Said], tuple[str, ...], str]] = {
    "missing": ([ONE], (), "0 topics of pictures have 'right' in their names"),
    "several": ([ONE, OTHER, small("/camera2/left/image_rect")], (), "2 topics of pictures have 'left'"),
    "not in it": ([ONE, OTHER], ("--left", "/cam0"), "/cam0 is not in it; topics of pictures: /camera/left"),
    "wrong type": (
        [ONE, OTHER, ("/info", info(START_NS, False), START_NS)], ("--left", "/info"),
        "/info is of sensor_msgs/msg/CameraInfo",
    ),
    "encoding": ([ONE, small(RIGHT, encoding="32FC1")], (), "right eye: encoding '32FC1', known are mono8"),
    "stamps": ([ONE, small(RIGHT, at_ns=5_000_000_000)], (), "stamped 5 s, no time of a clock that is set"),
    "unsynchronised": (
        [small(topic, START_NS + hours * 3_600_000_000_000 + k * PERIOD_NS)
         for k in range(2) for topic, hours in ((LEFT, 0), (RIGHT, 1))],
        (), "no picture of one eye is within half a period",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_what_cannot_be_read_is_refused_by_name(what: str, tmp_path: Path) -> None:
    said, options, words = WRONG[what]
    assert words in read(bag(tmp_path, said), tmp_path / "to", *options, status=2)


def test_rows_that_are_too_short_and_files_that_are_no_bag_are_refused(tmp_path: Path) -> None:
    cut = raw(np.full((8, 10), 100, dtype=np.uint8), START_NS)
    cut.data = cut.data[:-3]
    done = read(bag(tmp_path, [ONE, (RIGHT, cut, START_NS)]), tmp_path / "to", status=2)
    assert "77 bytes for 10 x 8 in rows of 10" in done
    (tmp_path / "no.mcap").write_bytes(b"no bag")
    for path in (tmp_path / "no.mcap", tmp_path / "nowhere"):
        assert "configuration.bad_bag" in read(path, tmp_path / "to2", status=2)


def test_raw_pictures_get_no_calibration_of_rectified_ones(tmp_path: Path) -> None:
    infos = [
        (f"/camera/{eye}/camera_info", info(START_NS, eye == "right", 0.1), START_NS)
        for eye in ("left", "right")
    ]
    done = read(bag(tmp_path, [ONE, OTHER, *infos]), tmp_path / "to")
    assert "no calibration is written: CameraInfo of the left eye has distortion" in done


CHANGED: dict[str, tuple[str, Any, str]] = {
    "distortion": ("d", np.full(5, 0.01), "has distortion"),
    "turn": ("r", cv2.Rodrigues(np.array([0.0, 0.01, 0.0]))[0].ravel(), "turns it"),
    "intrinsics": ("k", np.array([500.0, 0, 600, 0, 500, 350, 0, 0, 1]), "another K than P"),
    "projection": ("p", np.array([FX, 0, 639.5, -9.0, 0, FX, 340.0, 0, 0, 0, 1, 0]), "another K than P"),
    "lens": ("pk", 1.05, "differ in fx, fy or cy"),
}


@pytest.mark.parametrize("what", CHANGED)
@pytest.mark.parametrize("name", ["image_raw", "image_rect", "rectified/image"])
def test_matrices_tell_rectified_pictures_never_the_name(what: str, name: str, tmp_path: Path) -> None:
    field, value, words = CHANGED[what]
    said: list[Said] = []
    for eye in ("left", "right"):
        told = info(START_NS, eye == "right")
        if eye == "right" and field == "pk":
            for part, columns in (("p", 4), ("k", 3)):
                rows = getattr(told, part).reshape(3, columns) * np.array([[value], [1.0], [1.0]])
                setattr(told, part, rows.ravel())
        elif eye == "right":
            setattr(told, field, value)
        topic = f"/camera/{eye}/{name}"
        said += [small(topic), (f"{topic.rpartition('/')[0]}/camera_info", told, START_NS)]
    assert words in read(bag(tmp_path, said), tmp_path / "to")
    assert not (tmp_path / "to" / "calibration.yaml").exists()
