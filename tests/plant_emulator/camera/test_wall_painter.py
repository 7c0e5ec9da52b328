"""How the wall's texture is kept for its painter."""

import numpy as np

from plant_emulator.core.camera.wall.wall_painter import MARGIN, _load, packed


def test_one_load_takes_the_four_texels_of_a_sample_across_the_seams_too() -> None:
    texture = np.random.default_rng(1).integers(0, 256, (64, 64), dtype=np.uint8)
    rows, columns = np.indices(texture.shape, dtype=np.int32)
    words = (rows * np.int32(64 + MARGIN) + columns).ravel()

    _load(packed(texture), words, words.size)

    right, below = np.roll(texture, -1, axis=1), np.roll(texture, -1, axis=0)
    both = np.roll(right, -1, axis=0)
    taken = words.view(np.uint8).reshape(64, 64, 4)
    np.testing.assert_array_equal(taken, np.stack([texture, below, right, both], axis=-1))
