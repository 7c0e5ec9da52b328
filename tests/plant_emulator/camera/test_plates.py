"""Plates with a picture: where in the eye's picture they are looked for, and what is painted of them."""

import numpy as np

from plant_emulator.core.camera.plates import placed, ray_to_plane
from plant_emulator.core.camera.rays import Rays
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
