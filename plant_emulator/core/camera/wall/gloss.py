"""Wet patches of the wall: the highlight of a lamp on them, painted over the wall pixel by pixel.

It is no paint: it lies where a mirror would show the lamp, so elsewhere for each eye, and moves with it.
"""

import math

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from plant_emulator.config.camera import GlareConfig
from plant_emulator.config.surroundings import BarePatchConfig
from plant_emulator.core.camera.rays import Lens, Rays, highlight, meet_plate, row_homography
from plant_emulator.core.camera.surroundings import glare_on
from plant_emulator.core.camera.wall.bores import View

Grey = NDArray[np.uint8]
Matrix = NDArray[np.float64]

_RIM = 0.15  # of the radius over which a patch ends
_SEEN_GREY = 0.5  # less than this is not painted
_NEAREST_M = 0.05


def shine(
    picture: Grey,
    rays: Rays,
    patches: tuple[BarePatchConfig, ...],
    lamp: GlareConfig,
    seen: View,
    X_EO: Matrix,
    lens: Lens,
) -> None:
    """Add the highlights on wet ``patches`` to ``picture``, as far as they are in it.

    ``X_EO`` (4, 4): the wall in the eye. Relief does not move them.
    """
    height, width = picture.shape
    eye_O = np.array([seen.eye[0], -seen.eye[1], seen.eye[2]])
    for patch in patches:
        if patch.gloss_grey == 0.0:
            continue
        own = lamp.model_copy(update={"strength_grey": patch.gloss_grey, "width_m": patch.gloss_width_m})
        glare = glare_on(own, np.eye(4), eye_O)
        turns = np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False)
        rim = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(24)]) * 1.05 * patch.radius_m
        rim[:, :2] += patch.centre_m
        ends = rim @ X_EO[:3, :3].T + X_EO[:3, 3]
        if glare[3] == 0.0 or ends[:, 2].min() < _NEAREST_M:
            continue
        places = lens.project(ends)
        if not np.isfinite(places).all():
            continue
        low, high = np.floor(places.min(axis=0)) - 2.0, np.ceil(places.max(axis=0)) + 3.0
        left, top = np.clip(low, 0, (width, height)).astype(int).tolist()
        right, bottom = np.clip(high, 0, (width, height)).astype(int).tolist()
        if top < bottom and left < right:
            disc = np.array([patch.centre_m[0], -patch.centre_m[1], patch.radius_m])
            _shine(
                picture, rays, disc, glare, seen.homographies, (top, bottom, left, right), np.empty((3, 3))
            )


@allocation_free(nogil=True)
def _shine(
    picture: Grey,
    rays: Rays,
    disc: Matrix,
    glare: Matrix,
    homographies: Matrix,
    box: tuple[int, int, int, int],
    h: Matrix,
) -> None:
    for i in range(box[0], box[1]):
        row_homography(homographies, i, picture.shape[0], h)
        for j in range(box[2], box[3]):
            at = meet_plate(rays, h, i, j)
            if not at.in_front:
                continue
            far = math.hypot(at.s - disc[0], at.t - disc[1]) / disc[2]
            added = highlight(at.s, at.t, glare) * min(max((1.0 - far) / _RIM, 0.0), 1.0)
            if added > _SEEN_GREY:
                picture[i, j] = np.uint8(min(np.float64(picture[i, j]) + added, 255.0) + 0.5)
