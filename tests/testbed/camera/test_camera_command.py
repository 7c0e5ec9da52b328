"""`longreach camera`: pictures of the emulator's raw camera become a file by which its pairs are
rectified.
"""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from protocol.errors import ConfigurationError
from testbed.camera.pairs import require_whole, write_whole_film
from tests.support.commands import ran
from tests.support.paths import CONFIGS
from tests.vision_pc.config.test_camera_files import ZED
from tests.vision_pc.perception.test_pair_check import SIZE, pair_with
from vision_pc.config.camera_files.reading import read_calibration
from vision_pc.shell.cameras.grey_files import read_grey

pytestmark = pytest.mark.slow("pictures are drawn for calibrations")

BOARD = ["--columns", "9", "--rows", "6", "--square-mm", "60"]
_HALF = (
    "{fx_px: 266.7, fy_px: 266.35, cx_px: 325.8, cy_px: 174.15, k1: -0.12, k2: 0.02, p1: 0.0004, p2: -0.0003}"
)
_OTHER = "{fx_px: 1.0, fy_px: 0.8, cx_px: -7.1, cy_px: 3.7, k1: 0.006, k2: -0.002}"
HALVED = [  # the raw camera with a quarter of the pixels: a test has little time
    word
    for key in ("width_px=640", "height_px=360", f"lens={_HALF}", f"lens_difference={_OTHER}")
    for word in ("--set", f"scene.camera.{key}")
]
HALF_SIZE = ["--set", "vision.camera.width_px=640", "--set", "vision.camera.height_px=360"]
CONFIG = ["--config-dir", str(CONFIGS)]
SMALL = ["--set", f"vision.camera.width_px={SIZE[0]}", "--set", f"vision.camera.height_px={SIZE[1]}"]


def pictures(directory: Path, down: float, count: int = 3, *, exchanged: bool = False) -> Path:
    """Pairs whose right rows are ``down`` px too low, as files left… and right…."""
    directory.mkdir()
    pair = pair_with(down)
    for k in range(count):
        for eye, picture in (("left", pair.left), ("right", pair.right)):
            name = {"left": "right", "right": "left"}[eye] if exchanged else eye
            cv2.imwrite(str(directory / f"{name}{k:02d}.png"), picture)
    return directory


def test_a_film_of_the_raw_camera_becomes_a_file_that_rectifies_it(tmp_path: Path) -> None:
    film, file, figures = tmp_path / "boards.avi", tmp_path / "camera.yaml", tmp_path / "figures.json"
    ran("camera", "emulate", *BOARD, "--pairs", 9, "--out", film, *HALVED, *CONFIG)
    ran("camera", "calibrate", film, *BOARD, "--out", file, "--json", figures, *HALF_SIZE, *CONFIG)
    found = read_calibration(file)
    assert found.right_position_m[0] == pytest.approx(0.11967, rel=0.02)
    assert found.left.fx_px == pytest.approx(266.7, rel=0.02)
    assert json.loads(figures.read_text())["rows_rms_px"] < 0.2
    use = [*HALF_SIZE, "--set", f"vision.camera.calibration={file}"]
    check = ("camera", "check", film, "--board", "--pairs", 2, *BOARD, *CONFIG)
    assert "BAD: rows off, median" in ran(*check, *HALF_SIZE, status=1).output
    ran(*check, *use)


def test_pictures_of_the_markers_show_them_to_both_eyes(tmp_path: Path) -> None:
    """The last step of "Your camera in an hour": the film of the board had none."""
    to = tmp_path / "markers"
    made = ran("camera", "emulate", "--markers", "--pairs", 2, "--out", to, *HALVED, *CONFIG)
    assert "2 raw pairs of the markers" in made.output
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000)
    for eye in ("left", "right"):
        first, _ = sorted((tmp_path / "markers").glob(f"{eye}*.png"))
        _, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(read_grey(first))
        assert set(np.ravel(ids).tolist()) == {0, 1, 2, 3}


@pytest.mark.parametrize(
    ("down", "exchanged", "bad"), [(0.1, False, ""), (3.0, False, "rows off, median"), (0.1, True, "eyes")]
)
def test_the_check_says_what_is_bad_and_ends_accordingly(
    tmp_path: Path, down: float, exchanged: bool, bad: str
) -> None:
    shown = pictures(tmp_path / "pairs", down, exchanged=exchanged)
    done = ran("camera", "check", shown, *SMALL, *CONFIG, status=1 if bad else 0)
    assert (f"BAD: {bad}" if bad else "verdict: good") in done.output


@pytest.mark.parametrize("command", ["check", "calibrate"])
def test_a_source_that_holds_no_pairs_is_named(tmp_path: Path, command: str) -> None:
    cv2.imwrite(str(tmp_path / "left1.png"), np.zeros((4, 4), np.uint8))
    done = ran("camera", command, tmp_path, *CONFIG, status=2)
    assert "1 pictures of the left eye and 0 of the right one" in done.stderr


def test_a_zed_file_is_converted_and_a_bad_size_is_named(tmp_path: Path) -> None:
    zed, to = tmp_path / "SN1.conf", tmp_path / "camera.yaml"
    zed.write_text(ZED)
    convert = ("camera", "convert")
    ran(*convert, zed, "--size", "1280x720", "--out", to)
    assert read_calibration(to) == read_calibration(zed, (1280, 720))
    for words, told in (
        ((zed, "--size", "720p"), "WIDTHxHEIGHT is wanted"),
        ((to, "--size", "640x360"), "for pictures of 1280x720, --size says 640x360"),
        ((zed,), "give --size WIDTHxHEIGHT of one eye"),
    ):
        assert told in ran(*convert, *words, status=2).stderr


def test_a_film_that_a_full_disk_cut_is_not_whole(tmp_path: Path) -> None:
    film = tmp_path / "cut.avi"
    pair = pair_with(0.0)
    pairs = [pair._replace(frame_id=k) for k in range(3)]
    write_whole_film(pairs, film)
    film.write_bytes(film.read_bytes()[: int(0.9 * film.stat().st_size)])
    with pytest.raises(ConfigurationError, match="not all of 3 pairs"):
        require_whole(film, 3)
