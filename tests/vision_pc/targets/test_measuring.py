"""Targets in pictures of a renderer that shares no code with the plant's: right, honest, or refused."""

import numpy as np
import pytest

from tests.vision_pc.rendering import facing
from tests.vision_pc.targets.wall_scene import (
    CAMERA,
    DIAMETER,
    HOLES,
    SIZE,
    TEXEL,
    X_CM,
    WallScene,
    rock,
    scene,
)
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.targets import measuring, plane_patch
from vision_pc.core.targets.known_target import again
from vision_pc.core.targets.measuring import at_click, holes
from vision_pc.core.targets.round_edge import RAYS, DarkSpot, edge
from vision_pc.core.targets.sighting import Click, KnownTarget
from vision_pc.core.targets.target import TargetRefused, frame_on
from vision_pc.core.targets.wider_patch import normal_std, wider

TILTED = facing(0.03, -0.02, 1.0, (9.0, -13.0, 4.0))


@pytest.fixture(scope="module")
def face() -> WallScene:
    return scene(rock(), TILTED)


def refused(sighted: object, click: Click) -> TargetRefused:
    with pytest.raises(TargetRefused) as caught:
        at_click(sighted, click)  # type: ignore[arg-type]
    return caught.value


@pytest.mark.slow("a wall is drawn")
def test_a_clicked_place_is_where_it_is_with_the_surfaces_normal(face: WallScene) -> None:
    for place in ((-0.02, 0.05), (0.25, -0.10), (-0.30, -0.12)):
        seen = at_click(face.sighted(), Click(face.pixel(*place)))
        assert seen.kind == "plane"
        truth = frame_on(face.point(*place), face.X_CW[:3, 2])
        off = se3.local(seen.X_CO, truth)
        assert np.linalg.norm(off[:3]) < 0.003  # the right eye's offset is known from the tool's marker alone
        assert np.degrees(np.arccos(seen.X_CO[:3, 2] @ truth[:3, 2])) < 1.5
        assert off @ np.linalg.solve(seen.covariance, off) < 30.0  # χ² of six: 1 in 25,000
        assert np.sqrt(seen.covariance[2, 2]) < 0.004


def test_every_hole_is_found_and_measured_and_nothing_else(face: WallScene) -> None:
    found = holes(face.sighted())
    assert len(found) == len(HOLES)
    for place in HOLES:
        seen = min(found, key=lambda hole: float(np.linalg.norm(hole.X_CO[:3, 3] - face.point(*place))))
        p = face.point(*place)
        ray = p / np.linalg.norm(p)
        off = seen.X_CO[:3, 3] - p
        assert np.linalg.norm(off - ray * (ray @ off)) < 0.0005
        assert seen.diameter_m == pytest.approx(DIAMETER, abs=0.002)
        assert off @ np.linalg.solve(seen.covariance[:3, :3], off) < 22.0
        assert np.abs(seen.outline.mean(axis=0) - face.pixel(*place)).max() < 1.0


def test_a_hole_that_is_wider_than_what_is_compared_elsewhere_is_found_close_to_the_wall() -> None:
    close = scene(rock(), facing(0.01, 0.02, 0.38, (6.0, -9.0, 4.0)), tool=False)
    found = holes(close.sighted())
    assert len(found) == len(HOLES)
    for place in HOLES:
        p = close.point(*place)
        seen = min(found, key=lambda hole: float(np.linalg.norm(hole.X_CO[:3, 3] - p)))
        ray = p / np.linalg.norm(p)
        off = seen.X_CO[:3, 3] - p
        assert np.linalg.norm(off - ray * (ray @ off)) < 0.0004
        assert seen.diameter_m == pytest.approx(DIAMETER, abs=0.001)
        k1_turns = 3.0 * 0.001 * 0.12 / p[2]  # that near the eyes see it from places so far apart
        assert np.sqrt(seen.bias[3, 3] + seen.bias[4, 4]) > 0.8 * k1_turns


def test_a_hole_that_is_dark_in_a_part_of_it_alone_is_measured_whole() -> None:
    wall, radius = rock(), 0.5 * DIAMETER / TEXEL
    rows, columns = np.indices(wall.shape)
    x, y = columns - (SIZE - 1) / 2 - HOLES[0][0] / TEXEL, rows - (SIZE - 1) / 2 + HOLES[0][1] / TEXEL
    wall[(np.hypot(x, y) < radius - 1.0) & (x < 0.1 * radius)] = 95.0
    close = scene(wall, facing(0.01, 0.02, 0.38, (6.0, -9.0, 4.0)), tool=False)
    found = holes(close.sighted())
    assert len(found) == len(HOLES)
    p = close.point(*HOLES[0])
    seen = min(found, key=lambda hole: float(np.linalg.norm(hole.X_CO[:3, 3] - p)))
    assert np.linalg.norm(seen.X_CO[:3, 3] - p) < 0.0005
    assert seen.diameter_m == pytest.approx(DIAMETER, abs=0.0015)


def test_a_hole_of_which_a_part_is_a_spot_too_is_told_once(
    face: WallScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = measuring.dark_spots(face.pair.left)
    parts = [DarkSpot(spot.middle + 0.3 * spot.radius, 0.8 * spot.radius) for spot in whole]
    monkeypatch.setattr(measuring, "dark_spots", lambda _: [*whole, *parts])
    assert len(holes(face.sighted())) == len(HOLES)


def test_a_click_in_a_hole_means_the_hole_and_a_hole_of_another_size_is_none(face: WallScene) -> None:
    pixel = face.pixel(*HOLES[0]) + np.array([4.0, -3.0])
    seen = at_click(face.sighted(), Click(pixel))
    assert seen.kind == "hole"
    assert np.linalg.norm(seen.X_CO[:3, 3] - face.point(*HOLES[0])) < 0.003
    assert refused(face.sighted(), Click(pixel, "hole", 70.0)).cause in (
        "target.wrong_size",
        "target.no_match",
    )
    assert refused(face.sighted(), Click(face.pixel(-0.3, -0.2), "hole")).cause == "target.no_hole"


def test_a_pattern_that_repeats_is_ambiguous_until_the_other_eye_is_clicked_too() -> None:
    cells = np.indices((SIZE, SIZE)) // 25
    chessboard = np.where(cells.sum(axis=0) % 2, 60.0, 180.0).astype(np.float32)
    board = scene(chessboard, facing(0.0, 0.0, 1.0, (4.0, -6.0, 3.0)))
    pixel = board.pixel(0.012, 0.013)
    why = refused(board.sighted(), Click(pixel, "plane"))
    assert why.cause == "target.ambiguous"
    assert len(why.candidates) > 1
    true = board.point(0.012, 0.013)
    assert min(np.linalg.norm(candidate.p_C - true) for candidate in why.candidates) < 0.02
    other = board.pixel(0.012, 0.013, "right")
    seen = at_click(board.sighted(), Click(pixel, "plane", other=other))
    assert np.linalg.norm(seen.X_CO[:3, 3] - true) < 0.004


@pytest.mark.parametrize(
    ("pixel", "cause"),
    [
        ((5.0, 300.0), "outside_picture"),
        ((640.0, 719.0), "outside_picture"),
        ((2000.0, 5.0), "outside_picture"),
    ],
)
def test_a_click_outside_the_picture_is_refused(
    face: WallScene, pixel: tuple[float, float], cause: str
) -> None:
    assert refused(face.sighted(), Click(np.array(pixel))).cause == f"target.{cause}"


def test_a_bare_wall_is_refused() -> None:
    bare = scene(np.full((SIZE, SIZE), 118.0, np.float32), TILTED)
    for u in (400.0, 600.0, 900.0):
        assert refused(bare.sighted(), Click(np.array([u, 250.0]))).cause == "target.low_texture"


def test_an_edge_of_shade_on_a_bare_wall_tells_nothing_of_it() -> None:
    rows, columns = np.indices((SIZE, SIZE), dtype=np.float32)
    shaded = scene(120.0 + 20.0 * np.tanh((0.3 * rows + columns - 0.65 * SIZE) / 24.0), TILTED)
    pixel = shaded.pixel(0.0, 0.0)
    assert refused(shaded.sighted(), Click(pixel, "plane")).cause == "target.low_texture"


def test_a_place_on_a_depth_edge_is_refused() -> None:
    near = facing(0.03, -0.02, 0.86, (9.0, -13.0, 4.0))
    edge = scene(rock(), TILTED, step=(-0.05, near))
    pixel = se3.apply(near, np.array([[-0.05, 0.0, 0.0]]))[0]
    at = CAMERA.left.K[:2, :2] @ (pixel[:2] / pixel[2]) + CAMERA.left.K[:2, 2]
    for offset in (-2.0, 3.0, 8.0):
        cause = refused(edge.sighted(), Click(at + np.array([offset, 0.0]), "plane")).cause
        assert cause in ("target.depth_edge", "target.not_planar", "target.ambiguous", "target.no_match")


def test_a_known_hole_is_measured_again_from_a_wrong_guess_and_keeps_its_axes(face: WallScene) -> None:
    X = frame_on(face.point(*HOLES[2]), face.X_CW[:3, 2])
    turned = X @ se3.transform(se3.exp_so3([0.0, 0.0, 0.4]), [0.004, -0.003, 0.006])
    known = KnownTarget("hole", turned, np.diag([4e-6] * 3 + [1e-4] * 3), DIAMETER)
    seen = again(face.sighted(), known)
    assert np.linalg.norm(seen.X_CO[:3, 3] - X[:3, 3]) < 0.003
    assert se3.angle_between(seen.X_CO[:3, :3], turned[:3, :3]) < np.radians(1.0)
    far = known._replace(X_CO=se3.transform(X[:3, :3], face.point(0.3, -0.1)))
    with pytest.raises(TargetRefused, match="where it is expected"):
        again(face.sighted(), far)


def test_however_often_the_tools_marker_was_seen_its_print_bounds_what_is_told_of_depth(
    face: WallScene,
) -> None:
    sighted, place = face.sighted(), (-0.02, 0.05)
    offset = sighted.observation.offset
    assert offset is not None
    often = offset._replace(std_x_px=0.03)
    surest = sighted._replace(observation=sighted.observation._replace(offset=often))
    Z, Z_M = face.point(*place)[2], X_CM[2, 3]
    printed = sighted.markers.print_size_std * Z**2 / Z_M  # a print's share of the marker's disparity
    assert at_click(surest, Click(face.pixel(*place))).covariance[2, 2] ** 0.5 > printed
    blind = sighted._replace(observation=sighted.observation._replace(X_CM=None, X_CO=None))
    assert at_click(blind, Click(face.pixel(*place))).covariance[2, 2] ** 0.5 > 0.001


def test_a_normal_is_better_known_where_the_surface_is_flat_far_around(face: WallScene) -> None:
    far = scene(rock(contrast=8.0), facing(0.03, -0.02, 1.9, (9.0, -13.0, 4.0)), tool=False)
    pixel = far.pixel(0.30, -0.20)
    small = plane_patch.align(far.pair, CAMERA, pixel, 1.0 / far.point(0.30, -0.20)[2], 30)
    large = wider(far.pair, CAMERA, small, pixel, 56, None)
    assert normal_std(large) < 0.5 * normal_std(small)
    truth = far.X_CW[:3, 2]
    turned = [
        np.degrees(np.arccos(abs(plane.n @ truth) / np.linalg.norm(plane.n))) for plane in (small, large)
    ]
    assert turned[1] < 1.5


def test_a_known_target_behind_the_tool_is_hidden(face: WallScene) -> None:
    behind = X_CM[:3, 3] * (1.0 / X_CM[2, 3])
    known = KnownTarget("hole", frame_on(behind, face.X_CW[:3, 2]), 1e-6 * np.eye(6), DIAMETER)
    with pytest.raises(TargetRefused) as caught:
        again(face.sighted(), known)
    assert caught.value.cause == "target.hidden"


def test_a_click_on_the_tool_is_refused_however_well_the_tool_itself_could_be_measured(
    face: WallScene,
) -> None:
    for place in ((0.0, 0.0), (0.05, -0.05), (-0.07, 0.0), (0.0, -0.08)):  # marker, plate, its rim, bracket
        p = se3.apply(X_CM, np.array([[*place, 0.0]]))
        pixel = intrinsics.project(CAMERA.left, p)[0]
        for kind in ("auto", "plane", "hole"):
            told = refused(face.sighted(), Click(pixel, kind))  # type: ignore[arg-type]
            assert (told.cause, str(told)) == ("target.hidden", "target: the tool is before it")


@pytest.mark.parametrize("light", [1.0, 0.25])
def test_the_edge_of_a_hole_is_found_in_sun_and_in_shade_and_none_in_noise(light: float) -> None:
    rng = np.random.default_rng(4)
    rows, columns = np.mgrid[:80, :80]
    off = np.hypot(columns - 40.3, rows - 39.6)
    wall = 112.0 - 64.0 * np.clip(11.5 - off, 0.0, 1.0)  # 48 in the hole, of 11 px
    noise = rng.normal(0.0, 2.0, wall.shape)
    found = edge(np.clip(light * wall + noise, 0, 255).astype(np.uint8), SPOT)
    assert len(found) >= 0.9 * RAYS
    assert np.abs(found.mean(axis=0) - (40.3, 39.6)).max() < 0.3
    bare = np.clip(light * 112.0 + noise, 0, 255).astype(np.uint8)
    assert len(edge(bare, SPOT)) < 0.1 * RAYS


SPOT = DarkSpot(np.array([40.0, 40.0]), 11.0)
