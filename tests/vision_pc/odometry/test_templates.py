"""The patches that a keyframe keeps: normalised, with gradients that brightness and contrast do not move."""

import numpy as np
import pytest

from vision_pc.core.odometry.keyframes.templates import Templates
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

SIDE = 21
PIXELS = np.array([[40.25, 30.75], [80.0, 50.0], [5.0, 40.0], [100.0, 60.0]])
_FLAT_PLACE = 3


@pytest.fixture
def picture(generator: np.random.Generator) -> Image:
    image = generator.integers(0, 256, (90, 140), dtype=np.uint8)
    x, y = PIXELS[_FLAT_PLACE].astype(int)
    image[y - SIDE : y + SIDE, x - SIDE : x + SIDE] = 77
    return image


def seen(image: Image, pixel: Array) -> Array:
    """The patch around ``pixel``, bilinear, of mean 0 and norm 1."""
    offsets = np.arange(SIDE) - SIDE // 2
    x, y = pixel[0] + offsets[None, :], pixel[1] + offsets[:, None]
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - left, y - top
    upper = image[top, left] * (1 - fx) + image[top, left + 1] * fx
    lower = image[top + 1, left] * (1 - fx) + image[top + 1, left + 1] * fx
    patch = upper * (1 - fy) + lower * fy
    patch -= patch.mean()
    return np.asarray(patch / np.linalg.norm(patch))


def test_patches_and_gradients_are_those_of_the_definition(picture: Image) -> None:
    made = Templates(picture, PIXELS, SIDE).patches()
    for n in (0, 1):
        expected = seen(picture, PIXELS[n])
        patch, gx, gy = made.patterns[n]
        np.testing.assert_allclose(patch, expected.ravel(), atol=1e-12)
        slope = np.zeros((SIDE, SIDE))
        slope[1:-1, 1:-1] = 0.5 * (expected[1:-1, 2:] - expected[1:-1, :-2])
        slope -= slope.mean()
        slope -= expected * (slope * expected).sum()
        np.testing.assert_allclose(gx, slope.ravel(), atol=1e-12)
        assert abs(gy @ patch) < 1e-12
        np.testing.assert_allclose(made.products[n], [gx @ gx, gx @ gy, gy @ gy], rtol=1e-10)


def test_where_the_picture_ends_or_is_flat_nothing_is_matched(picture: Image) -> None:
    assert np.isnan(Templates(picture, PIXELS, SIDE).patches().products[2:]).all()


def test_forgotten_patches_are_made_again_the_same(picture: Image) -> None:
    templates = Templates(picture, PIXELS, SIDE)
    before = templates.patches()
    assert templates.patches() is before
    templates.forget()
    after = templates.patches()
    assert after is not before
    np.testing.assert_array_equal(after.patterns, before.patterns)
