"""The arm as a line of points, by its drawing: what a person is shown of it."""

import numpy as np

from nominal_arm.dimensions import DhLink
from vision_pc.core.se3 import Array


def skeleton(links: tuple[DhLink, ...], q: tuple[float, ...]) -> Array:
    """Points (n + 1, 3) in B, m: the base's origin, then that of each link's frame; the last is the TCP.

    ``q`` (rad) are the joints; links beyond them stand still. Each link is Rz(θ) Tz(d) Tx(a) Rx(α)
    (Mäkinen et al. 2023, Table 1).
    """
    X = np.eye(4)
    points = [X[:3, 3].copy()]
    for index, link in enumerate(links):
        X = X @ _link(link, q[index] if index < len(q) else 0.0)
        points.append(X[:3, 3].copy())
    return np.array(points)


def _link(link: DhLink, q: float) -> Array:
    theta = q + link.theta_offset
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(link.alpha), np.sin(link.alpha)
    return np.array(
        [
            [c, -s * ca, s * sa, link.a * c],
            [s, c * ca, -c * sa, link.a * s],
            [0.0, sa, ca, link.d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
