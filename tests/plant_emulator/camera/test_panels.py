"""Plates with a picture: where in the eye's picture they are looked for, and what is painted of them."""

import cv2
import numpy as np
import pytest

from plant_emulator.core.camera import rasteriser
from plant_emulator.core.camera.fetching import pairs_of
from plant_emulator.core.camera.panel_painter import Panel, paint_panel
from plant_emulator.core.camera.plates import placed, ray_to_plane
from plant_emulator.core.camera.rays import Rays, Surface
from plant_emulator.core.mechanics.geometry import rotation_from_vector, transform
from tests.plant_emulator.camera.camera_world import clean_camera

SIZE = 1280, 720
HALF_M = 0.4
RIM = np.array([[x, y, 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]) * HALF_M
EYE = clean_camera().eyes[0]
RAYS = Rays(*EYE.lens.ray_map(*SIZE))
WIDEST = np.array([RAYS.x.min(), RAYS.x.max(), RAYS.y.min(), RAYS.y.max()])


def seen_share(X_EP: np.ndarray) -> float:
    """The share of every eighth pixel whose ray meets the plate in front of the eye, from its front."""
    rays = np.stack([RAYS.x[::8, ::8], RAYS.y[::8, ::8], np.ones_like(RAYS.x[::8, ::8])], axis=-1)
    s, t, nearness = np.moveaxis(rays @ ray_to_plane(X_EP).T, -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = (np.abs(s / nearness) < HALF_M) & (np.abs(t / nearness) < HALF_M) & (nearness > 1e-9)
    return float(inside.mean()) if X_EP[:3, 2] @ X_EP[:3, 3] < 0.0 else 0.0


def test_a_plate_beside_the_picture_is_not_looked_for_also_where_it_reaches_behind_the_eye() -> None:
    """Of what passed beside the eye every pixel was asked for, 12 ms an eye, and nothing painted."""
    rng, missed, beside, behind = np.random.default_rng(3), 0, 0, 0
    for _ in range(600):
        turn = np.array([np.pi, 0.0, 0.0]) + rng.normal(0.0, 0.8, 3)
        X_EP = transform(rotation_from_vector(turn), rng.uniform([-1.5, -1.5, -0.3], [1.5, 1.5, 1.0]))
        reaches_behind = bool(((RIM @ X_EP[:3, :3].T + X_EP[:3, 3])[:, 2] < 0.0).any())
        boxes = [one.box for one in placed(np.tile(RIM, (1, 2, 1)), X_EP[None, None], EYE.lens, SIZE, WIDEST)]
        seen = seen_share(X_EP)
        missed += seen > 0.0 and not boxes
        beside += seen == 0.0 and reaches_behind and bool(boxes)
        behind += reaches_behind
    assert missed == 0
    assert behind > 200
    assert beside < 0.15 * behind


@pytest.mark.parametrize("texel_m", [4e-3, 1e-3, 2.5e-4])
def test_a_picture_is_painted_as_its_rays_and_footprints_say(texel_m: float) -> None:
    """Footprints of a third of a texel to a dozen; the level between two halvings changes along each row."""
    count = round(2.0 * HALF_M / texel_m)
    rough = np.random.default_rng(4).integers(0, 256, (max(count // 4, 8),) * 2).astype(np.uint8)
    levels = [cv2.resize(rough, (count, count), interpolation=cv2.INTER_CUBIC)]
    for _ in range(4):
        levels.append(cv2.resize(levels[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    X_EP = transform(rotation_from_vector(np.array([np.pi - 0.5, 0.6, 0.1])), np.array([0.05, 0.0, 0.7]))
    homography = ray_to_plane(X_EP)
    picture, edges = np.zeros(SIZE[::-1], dtype=np.uint8), np.array([-HALF_M, HALF_M])
    surface = Surface(np.array([1.0, 0.0, 0.0]), np.zeros(6), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(4))
    box, pairs = (0, SIZE[1], 0, SIZE[0]), tuple(pairs_of(level) for level in levels)
    paint_panel(picture, RAYS, np.stack([homography] * 2), Panel(edges, edges, pairs), box, surface)

    rays = np.stack([RAYS.x, RAYS.y, np.ones_like(RAYS.x)], axis=-1).astype(np.float64)
    s, t, nearness = np.moveaxis(rays @ homography.T, -1, 0)
    s, t = s / nearness, t / nearness
    (s_v, s_u), (t_v, t_u) = np.gradient(s), np.gradient(t)
    level = np.clip(0.5 * np.log2(np.abs(s_u * t_v - s_v * t_u)) - np.log2(texel_m), 0.0, 4.0 - 1e-6)
    places = [
        cv2.remap(
            each.astype(np.float32),
            ((s + HALF_M) / texel_m / 2**k - 0.5).astype(np.float32),
            ((t + HALF_M) / texel_m / 2**k - 0.5).astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for k, each in enumerate(levels)
    ]
    fine, share = level.astype(int), level - level.astype(int)
    stacked = np.stack(places)
    expected = np.take_along_axis(stacked, fine[None], 0)[0] * (1.0 - share)
    expected += np.take_along_axis(stacked, np.minimum(fine + 1, 4)[None], 0)[0] * share
    well_inside = (np.abs(s) < HALF_M - 0.01) & (np.abs(t) < HALF_M - 0.01) & (nearness > 0.0)
    assert well_inside.mean() > 0.1
    off = np.abs(picture[well_inside] - expected[well_inside])
    assert off.max() < 6.0  # remap knows thirty-two places between two texels
    assert np.sqrt(np.mean(off**2)) < 1.0


def test_an_even_plate_is_painted_as_any_other_to_the_same_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    X_EP = transform(rotation_from_vector(np.array([np.pi - 0.5, 0.6, 0.1])), np.array([0.05, 0.0, 0.7]))
    homographies, edges = np.stack([ray_to_plane(X_EP)] * 2), np.array([-HALF_M, HALF_M])
    grid = rasteriser.Grid(edges, edges, np.full((1, 1), 140.0, np.float32))
    surface = Surface(np.array([1.1, 0.3, -0.2]), np.zeros(6), np.array([9.0, 4.0, 0.2, 0.5]), np.zeros(4))
    pictures = [np.full(SIZE[::-1], 60, dtype=np.uint8) for _ in range(2)]
    for picture in pictures:
        rasteriser.paint_plate(picture, RAYS, homographies, grid, (0, SIZE[1], 0, SIZE[0]), surface)
        monkeypatch.setattr(rasteriser, "_paint_even_rows", rasteriser._paint_rows)
    assert len(np.unique(pictures[0])) > 30
    np.testing.assert_array_equal(*pictures)
