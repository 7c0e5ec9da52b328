"""An AprilGrid as Kalibr draws it: its corners are found where they are, and wrong files are named."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from protocol.errors import LongreachError
from testbed.camera.boards import read_april_grid
from tests.support.commands import ran
from tests.support.paths import CONFIGS
from vision_pc.config.camera_files.reading import read_calibration
from vision_pc.core.perception import stereo_fit
from vision_pc.core.perception.april_grid import AprilGrid
from vision_pc.core.perception.board_finder import find_board
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

# The first codes of tag36h11 as the family publishes them: bit 6 i + j is module (i, j), white where set
CODES = {0: 0xD5D628584, 1: 0xD97F18B49, 2: 0xDD280910E, 3: 0xE479E9C98}
GRID = AprilGrid(4, 3, 0.08, 0.3)
MODULE = 10  # px of the drawing: gaps of 0.3 tags are whole ones
K = np.array([[800.0, 0.0, 480.0], [0.0, 790.0, 300.0], [0.0, 0.0, 1.0]])
SIZE = (960, 600)
YAML = "target_type: 'aprilgrid'\ntagCols: 4\ntagRows: 3\ntagSize: 0.08\ntagSpacing: 0.3\n"


def tag_of(number: int, border: int) -> Image:
    """One tag as Kalibr draws it: the code half a turn on, in ``border`` black modules."""
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    code = np.rot90(cv2.aruco.generateImageMarker(book, number, 8)[1:-1, 1:-1], 2)
    return np.pad(code, border)


def drawing(grid: AprilGrid, border: int = 2) -> tuple[Image, float]:
    """The board with a white rim of two tags' sides, and its pixels a metre; corner squares as Kalibr's."""
    side = (6 + 2 * border) * MODULE
    gap = round(grid.spacing * side)
    rim, step = 2 * side, side + gap
    height, width = (2 * rim + count * step - gap for count in (grid.rows, grid.columns))
    page = np.full((height, width), 255, np.uint8)
    for number in range(grid.columns * grid.rows):
        row, column = divmod(number, grid.columns)
        x, y = rim + column * step, height - rim - row * step - side
        tag = tag_of(number + grid.first, border)
        page[y : y + side, x : x + side] = cv2.resize(tag, (side, side), interpolation=cv2.INTER_NEAREST)
        for a in (x - gap, x + side):
            for b in (y - gap, y + side):
                page[b : b + gap, a : a + gap] = 0
    return page, side / grid.tag_m


def photograph(grid: AprilGrid, X_CB: Array, border: int = 2) -> Image:
    """The board at ``X_CB`` (4, 4) in a pinhole camera, four times as many pixels averaged."""
    page, scale = drawing(grid, border)
    rim = 2 * grid.tag_m * scale
    left, low = (0.5 - rim) / scale, (page.shape[0] - rim - 0.5) / scale
    to_board = np.array([[1 / scale, 0.0, left], [0.0, -1 / scale, low], [0.0, 0.0, 1.0]])
    finer = np.array([[4.0, 0.0, 1.5], [0.0, 4.0, 1.5], [0.0, 0.0, 1.0]])
    H = finer @ K @ X_CB[:3, [0, 1, 3]] @ to_board
    large = cv2.warpPerspective(page, H, (4 * SIZE[0], 4 * SIZE[1]), borderValue=(128,), flags=cv2.INTER_AREA)
    return np.asarray(cv2.resize(large, SIZE, interpolation=cv2.INTER_AREA), np.uint8)


def view_from(turn_deg: tuple[float, float, float], at: tuple[float, float, float]) -> Array:
    """X_CB (4, 4) of a board upright before the camera, then turned; ``at``: its middle, m."""
    X = np.eye(4)
    X[:3, :3] = cv2.Rodrigues(np.radians(turn_deg))[0] @ np.diag([1.0, -1.0, -1.0])
    middle = 0.5 * GRID.tag_m * np.array([4 + 3 * 0.3, 3 + 2 * 0.3, 0.0])
    X[:3, 3] = np.array(at) - X[:3, :3] @ middle
    return X


VIEWS = [view_from(*one) for one in (
    ((0, 0, 0), (0.0, 0.0, 0.7)), ((25, 10, 0), (0.05, 0.0, 0.75)), ((-20, 25, 40), (0.0, 0.02, 0.8)),
    ((5, -30, 170), (-0.05, 0.0, 0.8)))]  # fmt: skip


def test_the_drawing_has_the_family_s_codes() -> None:
    for number, code in CODES.items():
        bits = [[code >> (6 * i + j) & 1 for j in range(6)] for i in range(6)]
        np.testing.assert_array_equal(tag_of(number, 2)[2:-2, 2:-2] > 0, np.rot90(bits, 2))


@pytest.mark.parametrize("border", [2, 1])
@pytest.mark.parametrize("X_CB", VIEWS)
def test_corners_are_found_where_they_are(X_CB: Array, border: int) -> None:
    view = find_board(photograph(GRID, X_CB, border), GRID, "a")
    true = view.points_m @ X_CB[:3, :3].T + X_CB[:3, 3]
    pixels = true @ K.T
    assert len(view.pixels) == 4 * 12
    assert bool(view.second) is (border == 1)
    assert np.sqrt(np.mean((view.pixels - pixels[:, :2] / pixels[:, 2:]) ** 2)) < 0.1


def test_corners_of_a_part_have_their_places() -> None:
    picture = photograph(GRID, VIEWS[1])
    picture[:, :480] = 128
    part, whole = find_board(picture, GRID, "part"), find_board(photograph(GRID, VIEWS[1]), GRID, "whole")
    places = {tuple(point): pixel for point, pixel in zip(whole.points_m.round(9), whole.pixels, strict=True)}
    assert 8 <= len(part.pixels) < 48
    for point, pixel in zip(part.points_m.round(9), part.pixels, strict=True):
        np.testing.assert_allclose(pixel, places[tuple(point)], atol=0.1)
    assert len(stereo_fit.paired(part, whole).left) == len(part.pixels)


@pytest.mark.parametrize(
    ("was", "becomes", "cause", "told"),
    [
        ("tagCols: 4\n", "", "configuration.missing", "tagCols"),
        ("tagSpacing: 0.3\n", "", "configuration.missing", "tagSpacing"),
        ("tagCols: 4", "tagCols: '4'", "configuration.number", "tagCols = '4'"),
        ("tagSize: 0.08", "tagSize: 80", "configuration", "tagSize = 80"),
        ("tagSize: 0.08", "tagSize: 8,0", "configuration.number", "tagSize = '8,0'"),
        ("tagSpacing: 0.3", "tagSpacing: 30", "configuration", "tagSpacing = 30"),
        ("aprilgrid", "checkerboard", "configuration", "target_type = 'checkerboard'"),
        ("tagRows: 3", "tagRows: 300", "configuration", "tag36h11 has 587"),
        (
            "tagSpacing: 0.3",
            "tagSpacing: 0.024",
            "refused.board.spacing",
            "tagSpacing = 0.024: gaps of 0.30 tags",
        ),
        ("tagCols: 4", "tagCols: 3", "refused.board.counts", "tag 9; tagCols = 3 .* rows of 4 tags are seen"),
        (
            "tagCols: 4\ntagRows: 3",
            "tagCols: 3\ntagRows: 4",
            "refused.board.counts",
            "rows of 4 tags are seen",
        ),
        ("tagCols: 4", "tagCols: 6", "refused.board.counts", "rows of 4 tags are seen"),
        ("tagRows: 3", "tagRows: 2", "refused.board.counts", "shows tag 8; .* have 0 to 7"),
        (
            "tagSize: 0.08",
            "tagSize: 0.08\ncodeOffset: 2",
            "refused.board.counts",
            "shows tag 0; .* have 2 to 13",
        ),
    ],
)
def test_a_wrong_file_is_named(tmp_path: Path, was: str, becomes: str, cause: str, told: str) -> None:
    assert was in YAML
    (tmp_path / "grid.yaml").write_text(YAML.replace(was, becomes), encoding="utf-8")
    with pytest.raises(LongreachError, match=told) as refused:
        find_board(photograph(GRID, VIEWS[0]), read_april_grid(tmp_path / "grid.yaml"), "a")
    assert refused.value.cause.startswith(cause)


TURNS = [(0, 0, 0), (30, 0, 5), (-30, 0, -5), (0, 30, 10), (0, -30, 90), (25, 25, 0), (-25, 25, 180),
         (25, -25, 20), (-25, -25, 0), (10, 10, 45), (-10, 30, -45), (30, -10, 0)]  # fmt: skip


@pytest.mark.slow("pictures of twelve pairs are drawn")
def test_pairs_of_a_grid_become_a_calibration(tmp_path: Path) -> None:
    rng, baseline_m = np.random.default_rng(4), 0.06
    for k, turn in enumerate(TURNS):
        X_LB = view_from(turn, (0.2 * (k % 3 - 1), 0.1 * (k // 3 % 3 - 1), 0.65 + 0.1 * (k % 2)))
        for eye, x in (("left", 0.0), ("right", -baseline_m)):
            X_CB = X_LB.copy()
            X_CB[0, 3] += x
            grey = photograph(GRID, X_CB) + rng.normal(0.0, 1.0, SIZE[::-1])
            (tmp_path / eye).mkdir(exist_ok=True)
            cv2.imwrite(str(tmp_path / eye / f"{k:02d}.png"), grey.clip(0, 255).astype(np.uint8))
    (tmp_path / "grid.yaml").write_text(YAML, encoding="utf-8")
    files = (tmp_path, "--target", tmp_path / "grid.yaml", "--out", tmp_path / "out.yaml")
    ran("camera", "calibrate", *files, "--config-dir", CONFIGS)
    found = read_calibration(tmp_path / "out.yaml")
    assert found.left.fx_px == pytest.approx(K[0, 0], rel=2e-3)
    assert found.left.cx_px == pytest.approx(K[0, 2], abs=2.0)
    assert found.right_position_m == pytest.approx((baseline_m, 0.0, 0.0), abs=3e-4)
