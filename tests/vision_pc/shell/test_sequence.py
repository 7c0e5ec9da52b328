"""Sequences from disk: calibrations, times and refusals, and a trajectory that a TUM reader understands."""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from protocol.errors import ConfigurationError, MeasurementFailed
from tests.vision_pc.config.test_camera_files import ZED
from tests.vision_pc.odometry.test_odometry import pair_at
from tests.vision_pc.rendering import wall_texture
from vision_pc.config.camera_files.reading import read_calibration, write_calibration
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.types import CameraCalibration, StereoPair
from vision_pc.shell.cameras import sequence, sequence_calibration

YAML = "fx_px: 530.0\nfy_px: 530.0\ncx_px: 639.5\ncy_px: 359.5\nbaseline_m: 0.12\n"
KITTI = """P0: 530.0 0 639.5 0 0 530.0 359.5 0 0 0 1 0
P1: 530.0 0 639.5 -63.6 0 530.0 359.5 0 0 0 1 0
Tr: 1 0 0 0
"""


def written(directory: Path, pairs: list[StereoPair], names: list[str]) -> tuple[Path, Path]:
    for eye in ("left", "right"):
        (directory / eye).mkdir()
        for pair, name in zip(pairs, names, strict=True):
            cv2.imwrite(str(directory / eye / f"{name}.png"), getattr(pair, eye))
    return directory / "left", directory / "right"


def test_sequence_is_followed_and_written(
    camera: CameraCalibration, config: VisionConfig, tmp_path: Path
) -> None:
    texture = wall_texture(1, 22.0, 1000)
    true = [se3.transform(se3.exp_so3([0.0, 0.0, 0.02 * k]), (0.05 * k, 0.0, 0.02 * k)) for k in range(3)]
    pairs = [pair_at(camera, texture, X, seed=k) for k, X in enumerate(true)]
    left, right = written(
        tmp_path, pairs, [str(1_700_000_000_000_000_000 + 50_000_000 * k) for k in range(3)]
    )
    calibration = tmp_path / "camera.yaml"
    calibration.write_text(YAML, encoding="utf-8")
    heard: list[int] = []
    recorded = sequence.Recorded(left, right, calibration)
    outcome = sequence.follow(recorded, config, report=lambda record: heard.append(record.frame_id))
    assert (outcome.lost, outcome.losses, outcome.apart, heard) == (0, {}, [], [0, 1, 2])
    sequence.write_side_file(tmp_path / "path.csv", outcome)
    with (tmp_path / "path.csv").open(newline="") as stream:
        lines = list(csv.DictReader(stream))
    assert [(line["map"], line["joined"], line["loss"]) for line in lines] == [("0", "1", "")] * 3
    assert float(lines[2]["c_00"]) > float(lines[1]["c_00"]) > 0.0
    assert len(lines[0]) == 16 + 21
    sequence.write_tum(tmp_path / "path.tum", outcome.poses)
    table = np.loadtxt(tmp_path / "path.tum")
    np.testing.assert_allclose(np.diff(table[:, 0]), 0.05, atol=1e-6)
    for row, X in zip(table, true, strict=True):
        np.testing.assert_allclose(row[1:4], X[:3, 3], atol=0.2e-3)
        np.testing.assert_allclose(Rotation.from_quat(row[4:]).as_matrix(), X[:3, :3], atol=5e-4)


def test_bad_sequences_are_refused(config: VisionConfig, tmp_path: Path) -> None:
    blank = StereoPair(np.zeros((720, 1280), np.uint8), np.zeros((720, 1280), np.uint8), 0, 0)
    left, right = written(tmp_path, [blank] * 2, ["0", "1"])
    calibration = tmp_path / "calib.txt"
    with pytest.raises(ConfigurationError, match="no such directory"):
        sequence.Recorded(left, tmp_path / "nowhere", calibration).files()
    with pytest.raises(ConfigurationError, match=r"calib\.txt"):
        sequence.follow(sequence.Recorded(left, right, calibration), config)
    calibration.write_text("P0: 1 2 3\n", encoding="ascii")
    with pytest.raises(ConfigurationError, match="P0: and P1: are wanted"):
        sequence.follow(sequence.Recorded(left, right, calibration), config)
    calibration.write_text(KITTI, encoding="ascii")
    with pytest.raises(MeasurementFailed, match="all 2 pairs lost, last cause too_dark"):
        sequence.follow(sequence.Recorded(left, right, calibration), config)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (YAML, "cx_px 639.5 is 264 px from the middle of pictures of 752 x 480"),
        (YAML + "width_px: 1280\nheight_px: 720\n", "for pictures of 1280 x 720, but 752 x 480 came"),
    ],
)
def test_a_calibration_for_another_size_is_named(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "camera.yaml").write_text(text, encoding="utf-8")
    blank = np.zeros((480, 752), np.uint8)
    with pytest.raises(ConfigurationError, match=words) as refused:
        sequence_calibration.recorded_camera(tmp_path / "camera.yaml", StereoPair(blank, blank, 0, 0))
    assert refused.value.cause == "configuration.wrong_size"


def test_pairs_of_a_camera_as_it_comes_are_rectified_by_its_file(tmp_path: Path) -> None:
    """A ZED's file, and ours made of it; a file for another size says both."""
    zed, ours = tmp_path / "SN1.conf", tmp_path / "camera.yaml"
    zed.write_text(ZED, encoding="utf-8")
    write_calibration(ours, read_calibration(zed, (1280, 720)))
    picture = np.random.default_rng(1).integers(0, 255, (720, 1280), np.uint8)
    pair = StereoPair(picture, picture, 5, 1)
    found = [sequence_calibration.recorded_camera(file, pair) for file in (zed, ours)]
    np.testing.assert_array_equal(found[0].camera.left.K, found[1].camera.left.K)
    done = [one.rectified(pair) for one in found]
    np.testing.assert_array_equal(done[0].right, done[1].right)
    assert (done[0].frame_id, done[0].capture_ns) == (1, 5)
    assert not np.array_equal(done[0].left, picture)
    half = StereoPair(picture[::2, ::2].copy(), picture[::2, ::2].copy(), 0, 0)
    with pytest.raises(ConfigurationError, match="for pictures of 1280 x 720, but 640 x 360 came"):
        sequence_calibration.recorded_camera(ours, half)
    (tmp_path / "of_rectified.yaml").write_text(YAML, encoding="utf-8")
    assert sequence_calibration.recorded_camera(tmp_path / "of_rectified.yaml", pair).rectified(pair) is pair
