"""What the eyes' shared errors do to a plane, against the plane that eyes with such errors would see."""

import numpy as np
import pytest

from vision_pc.core.se3 import Array
from vision_pc.core.targets.place_on_plane import turned_by_radial

BASELINE_M = 0.12
K1 = 1e-4


def seen_by_wrong_eyes(n: Array, ray: Array) -> Array:
    """The plane (3,) 1/m that is fitted to what both eyes of an untold k1 see about ``ray``."""
    x, y = ray[0] + np.linspace(-0.02, 0.02, 21)[:, None], ray[1] + np.linspace(-0.02, 0.02, 21)[None, :]
    x, y = np.broadcast_arrays(x, y)
    d = BASELINE_M * (n[0] * x + n[1] * y + n[2])
    left, right = 1.0 + K1 * (x**2 + y**2), 1.0 + K1 * ((x - d) ** 2 + y**2)
    seen = np.column_stack([(x * left).ravel(), (y * left).ravel(), np.ones(x.size)])
    disparity = (x * left - (x - d) * right).ravel()
    return np.linalg.lstsq(BASELINE_M * seen, disparity, rcond=None)[0]


@pytest.mark.parametrize(
    ("n", "ray"),
    [
        ((0.0, 0.0, 2.5), (0.0, 0.0, 1.0)),
        ((0.0, 0.0, 1.0), (0.5, -0.2, 1.0)),
        ((0.4, 0.0, 1.2), (-0.3, 0.3, 1.0)),
        ((-0.3, 0.6, 1.0), (0.4, 0.3, 1.0)),
    ],
)
def test_an_error_of_k1_turns_a_plane_as_such_eyes_see_it(n: Array, ray: Array) -> None:
    n, ray = np.array(n), np.array(ray)
    off = (seen_by_wrong_eyes(n, ray) - n) / K1
    turned = turned_by_radial(n, ray, BASELINE_M)
    assert turned @ ray == pytest.approx(0.0, abs=1e-12), "its place on the ray is told apart"
    assert turned[:2] == pytest.approx(off[:2], abs=0.02 * np.abs(off[:2]).max() + 1e-3)
