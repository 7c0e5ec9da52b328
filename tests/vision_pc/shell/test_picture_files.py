"""Pictures in directories: their order, their partners, their times, and KITTI's cameras by folder."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from protocol.errors import ConfigurationError
from testbed.camera.checking import PLAIN
from testbed.camera.pairs import take
from testbed.cli.perception import read_tum
from vision_pc.config.camera import CameraSettings
from vision_pc.core.types import StereoPair
from vision_pc.shell.cameras.directory import read_grey
from vision_pc.shell.cameras.picture_files import eye_files, pictures_in
from vision_pc.shell.cameras.sequence_calibration import kitti_eyes, recorded_camera

BEGAN_NS = 1_403_636_579_763_555_584
PERIOD_NS = 100_000_000


def folder(directory: Path, names: list[str]) -> Path:
    directory.mkdir(parents=True)
    for name in names:
        (directory / f"{name}.png").touch()
    return directory


def stamps(numbers: list[int], shift_ns: int = 0) -> list[str]:
    return [str(BEGAN_NS + PERIOD_NS * k + shift_ns) for k in numbers]


@pytest.mark.parametrize(
    "names",
    [
        ["1", "2", "10", "11"],
        ["frame2", "frame10", "frame010b"],
        ["1403636579.5", "1403636579.75", "1403636580"],  # 75 hundredths, not after 5 tenths of 100
        ["a", "b1", "b2"],
    ],
)
def test_pictures_are_in_the_order_of_the_numbers_in_their_names(tmp_path: Path, names: list[str]) -> None:
    assert [path.stem for path in pictures_in(folder(tmp_path / "p", names[::-1]))] == names


def test_eyes_that_lost_different_pictures_are_matched_by_their_times(tmp_path: Path) -> None:
    left = folder(tmp_path / "left", stamps([k for k in range(24) if k != 6]))
    right = folder(tmp_path / "right", stamps([k for k in range(24) if k != 16], 3_000_000))
    found = eye_files(left, right, 10.0)
    assert len(found.files) == 22
    assert all(abs(int(one.stem) - int(other.stem)) == 3_000_000 for one, other in found.files)
    assert found.times_ns[:2] == [BEGAN_NS, BEGAN_NS + PERIOD_NS]
    notes = " ".join(found.notes)
    assert "nanoseconds, from the pictures' names" in notes
    assert "1 pictures of the left eye and 1 of the right one" in notes
    assert "up to 3.0 ms apart" in notes


def test_an_eye_that_begins_later_is_not_paired_with_other_moments(tmp_path: Path) -> None:
    left = folder(tmp_path / "left", stamps(list(range(23))))
    right = folder(tmp_path / "right", stamps(list(range(1, 24))))
    found = eye_files(left, right, 10.0)
    assert len(found.files) == 22
    assert all(one.stem == other.stem for one, other in found.files)


def test_eyes_whose_clocks_differ_are_refused_with_the_difference(tmp_path: Path) -> None:
    left = folder(tmp_path / "left", stamps(list(range(5))))
    right = folder(tmp_path / "right", stamps(list(range(5)), 9 * PERIOD_NS))
    with pytest.raises(ConfigurationError, match="the nearest are 500 ms apart"):
        eye_files(left, right, 10.0)


def test_names_that_only_count_are_matched_where_they_are_equal(tmp_path: Path) -> None:
    left = folder(tmp_path / "left", ["left_1", "left_2", "left_10"])
    right = folder(tmp_path / "right", ["right_1", "right_10", "right_11"])
    found = eye_files(left, right, 10.0)
    assert [one.stem for one, _ in found.files] == ["left_1", "left_10"]
    assert found.times_ns == [0, 2 * PERIOD_NS]
    assert "left_2.png, right_11.png" in " ".join(found.notes)
    other = folder(tmp_path / "other", ["a", "b", "c"])
    assert "left_1.png and a.png are taken for the first pair" in " ".join(eye_files(left, other, 1.0).notes)
    with pytest.raises(ConfigurationError, match="3 pictures, but 1"):
        eye_files(left, folder(tmp_path / "one", ["z"]), 10.0)


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        (["1403636579.763555", "1403636579.863555"], "seconds"),
        (["1403636579763", "1403636579863"], "milliseconds"),
        (["1403636579763555", "1403636579863555"], "microseconds"),
        (["1403636579763555584", "1403636579863555584"], "nanoseconds"),
    ],
)
@pytest.mark.parametrize("listed", [False, True])
def test_units_are_told_by_size(tmp_path: Path, names: list[str], unit: str, listed: bool) -> None:
    left = folder(tmp_path / "left", ["0", "1"] if listed else names)
    if listed:
        (tmp_path / "times.txt").write_text("\ufeff# of the left eye\n" + "\n".join(names), encoding="utf-8")
    found = eye_files(left, left, 25.0)
    assert found.times_ns[0] == pytest.approx(BEGAN_NS, abs=1_000_000)
    assert found.times_ns[1] - found.times_ns[0] == PERIOD_NS
    assert found.notes[0].startswith(f"times: {unit}, from ")


@pytest.mark.parametrize(
    ("lines", "times_ns"),
    [
        ("0.0\n1.5e-01\n2.5e-01\n", [0, 150_000_000, 250_000_000]),
        ("0\n100\n200\n", [0, PERIOD_NS, 2 * PERIOD_NS]),  # milliseconds: 100 s are no period
        ("0\n100000000\n200000000\n", [0, PERIOD_NS, 2 * PERIOD_NS]),
    ],
)
def test_times_from_zero_are_seconds_unless_periods_were_absurd(
    tmp_path: Path, lines: str, times_ns: list[int]
) -> None:
    left = folder(tmp_path / "left", ["000000", "000001", "000002"])
    assert eye_files(left, left, 20.0).times_ns == [0, 50_000_000, PERIOD_NS]
    (tmp_path / "times.txt").write_text(lines, encoding="ascii")
    assert eye_files(left, left, 20.0).times_ns == times_ns
    for wrong, why in (("0.0\n", "1 times for 3 pictures"), ("0\n0 1\n2\n", "line 2 is '0 1'")):
        (tmp_path / "times.txt").write_text(wrong, encoding="ascii")
        with pytest.raises(ConfigurationError, match=why):
            eye_files(left, left, 20.0)


def test_trajectories_in_nanoseconds_meet_those_in_seconds(tmp_path: Path) -> None:
    path = tmp_path / "truth.tum"
    path.write_text("".join(f"{BEGAN_NS + k * PERIOD_NS} {k} 0 0 0 0 0 1\n" for k in range(3)))
    np.testing.assert_allclose(read_tum(path)[0], 1e-9 * BEGAN_NS + 0.1 * np.arange(3), atol=1e-6)


def test_colour_eyes_have_their_own_matrices(tmp_path: Path) -> None:
    rows = {"P0": 0.0, "P1": -138.6, "P2": 8.19, "P3": -117.81}
    text = "".join(f"{name}: 420 0 319.5 {x} 0 420 199.5 0 0 0 1 0\n" for name, x in rows.items())
    (tmp_path / "calib.txt").write_text(text)
    blank = np.zeros((400, 640), np.uint8)
    pair = StereoPair(blank, blank, 0, 0)
    for names, baseline_m in ((("image_2", "image_3"), 0.30), (("image_00/data", "image_01/data"), 0.33),
                              (("left", "right"), 0.33)):  # fmt: skip
        eyes = kitti_eyes(tmp_path / names[0], tmp_path / names[1])
        found = recorded_camera(tmp_path / "calib.txt", pair, eyes)
        assert found.camera.right.X_CE[0, 3] == pytest.approx(baseline_m)
        assert f"P{eyes[0]} and P{eyes[1]}" in found.notes[0]
        assert f"baseline {baseline_m:.4f} m" in found.notes[0]


def test_a_transparent_picture_lies_on_white(tmp_path: Path) -> None:
    layers = np.zeros((4, 4, 4), np.uint8)
    layers[1:3, 1:3, 3] = 255
    cv2.imwrite(str(tmp_path / "a.png"), layers)
    expected = np.full((4, 4), 255, np.uint8)
    expected[1:3, 1:3] = 0
    np.testing.assert_array_equal(read_grey(tmp_path / "a.png"), expected)


def test_boards_are_taken_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for k in (1, 2, 10):
        for eye in ("left", "right"):
            cv2.imwrite(str(tmp_path / f"{eye}{k}.png"), np.full((8, 8), k, np.uint8))
    cv2.imwrite(str(tmp_path / "left3.png"), np.full((8, 8), 3, np.uint8))
    settings = CameraSettings(stale_ms=1000.0, frozen_frames=0, width_px=64, height_px=64, calibration=PLAIN)
    taken = take(str(tmp_path), settings, 9)
    assert taken.names == ["left1.png", "left2.png", "left10.png"]
    assert [int(pair.right[0, 0]) for pair in taken.pairs] == [1, 2, 10]
