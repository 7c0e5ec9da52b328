"""Shadow and glare in the coordinates of one plate, as the painters take them."""

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.lighting import GlareConfig, ShadowConfig

Array = NDArray[np.float64]

NO_SHADOW = np.array([0.0, 0.0, 0.0, 1.0])
NO_GLARE = np.zeros(4)


def shadow_on(config: ShadowConfig, X_OP: Array, edge_m: float) -> Array:
    """(per m right, per m down, constant, factor) of a plate at X_OP (4x4).

    The first three give the distance beyond the shadow's edge, ``edge_m`` now, in widths of its ramp.
    """
    if config.factor == 1.0:
        return NO_SHADOW.copy()
    normal = np.array(config.normal)
    right, up, origin = (normal @ X_OP[:2, column] for column in (0, 1, 3))
    beyond = np.array([right, -up, origin - edge_m]) / config.penumbra_m
    return np.append(beyond, config.factor)


def glare_on(config: GlareConfig, X_OP: Array, eye_P: Array) -> Array:
    """(place right, down (m), half the inverse variance, grey) of the highlight on a plate at X_OP (4x4).

    ``eye_P`` (3,): the eye in the plate's axes. A mirror shows the lamp where the way there and on to the
    eye is shortest.
    """
    if config.strength_grey == 0.0:
        return NO_GLARE
    lamp_P = X_OP[:3, :3].T @ (np.array(config.lamp_m) - X_OP[:3, 3])
    if lamp_P[2] <= 0.0 or eye_P[2] <= 0.0:
        return NO_GLARE
    x, y = (eye_P[:2] * lamp_P[2] + lamp_P[:2] * eye_P[2]) / (lamp_P[2] + eye_P[2])
    return np.array([x, -y, 0.5 / config.width_m**2, config.strength_grey])
