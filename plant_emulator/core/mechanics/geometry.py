"""The true arm as screw axes and a home pose, from the pivots of plant.yaml and its named geometric errors.

Written without any Denavit-Hartenberg parameter: with all joints at zero, boom, arm and wrist lie along the
base's x axis and each axis is simply where the drawing puts it. An error displaces its joint and everything
behind it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.plant import JointErrorConfig, PlantConfig
from plant_emulator.core.layout import COORDINATES, N_COORDINATES

Array = NDArray[np.float64]

FORWARD = np.array([1.0, 0.0, 0.0])
LEFT = np.array([0.0, 1.0, 0.0])
UP = np.array([0.0, 0.0, 1.0])
HOME_TOOL_AXES = np.column_stack((-LEFT, -UP, FORWARD))  # x_T right, y_T down, z_T forward


class Chain(NamedTuple):
    """Screw axes at home: unit ``axis`` and ``point`` on it (10, 3).

    ``link_origin`` (10, 3) is the nominal origin of each body's link, ``deviation`` (10, 4, 4) carries each
    body from its nominal home to its true one, ``X_BT_home`` (4, 4) is the tool's true pose there.
    """

    axis: Array
    point: Array
    link_origin: Array
    deviation: Array
    X_BT_home: Array


def rotation_from_vector(vector: Array) -> Array:
    """The (3, 3) rotation by the angle |vector| about its direction."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


def transform(rotation: Array, position: Array) -> Array:
    """The (4, 4) homogeneous transform of a rotation and a position."""
    X = np.eye(4)
    X[:3, :3] = rotation
    X[:3, 3] = position
    return X


def base_tilt(config: PlantConfig) -> Array:
    """The (4, 4) small rotation that turns the base as claimed into the base as it stands."""
    error = config.errors.base_tilt
    vector = np.array([error.x_mrad, error.y_mrad, 0.0]) * 1e-3 if error.enabled else np.zeros(3)
    return transform(rotation_from_vector(vector), np.zeros(3))


def _deviation(error: JointErrorConfig, about: Array) -> Array:
    rotation = rotation_from_vector(np.asarray(error.tilt_mrad) * 1e-3)
    return transform(rotation, about - rotation @ about + np.asarray(error.offset_mm) * 1e-3)


def build_chain(config: PlantConfig) -> Chain:
    """The chain's screw axes, home poses and tool pose, in base coordinates with every coordinate at zero."""
    geometry = config.geometry
    lift = np.array([geometry.lift_pivot_m[0], 0.0, geometry.lift_pivot_m[1]])
    tilt = lift + np.array([geometry.tilt_pivot_m[0], 0.0, geometry.tilt_pivot_m[1]])
    wrist = tilt + np.array([geometry.boom_tip_m[0] + geometry.telescope_m, 0.0, geometry.boom_tip_m[1]])
    tool = wrist + geometry.tool_length_m * FORWARD
    boom_hinge = lift + (tilt - lift) * _third(config.flexibility.boom.length_m, tilt - lift)
    arm_hinge = tilt + (wrist - tilt) * _third(config.flexibility.arm.length_m, wrist - tilt)
    # raising turns about −y (right-handed), lateral bending and slewing about z
    axes = (UP, -LEFT, -LEFT, UP, -LEFT, -LEFT, UP, FORWARD, LEFT, -FORWARD)
    points = (np.zeros(3), lift, boom_hinge, boom_hinge, tilt, arm_hinge, arm_hinge, wrist, wrist, wrist)
    origins = (np.zeros(3), lift, lift, lift, tilt, tilt, tilt, wrist, wrist, wrist)
    axis, point = np.zeros((N_COORDINATES, 3)), np.zeros((N_COORDINATES, 3))
    deviation = np.zeros((N_COORDINATES, 4, 4))
    errors, carried = config.errors.geometry, np.eye(4)
    for i, name in enumerate(COORDINATES):
        error: JointErrorConfig | None = getattr(errors, name, None)
        if errors.enabled and error is not None:
            carried = carried @ _deviation(error, points[i])
        deviation[i] = carried
        axis[i] = carried[:3, :3] @ axes[i]
        point[i] = carried[:3, :3] @ points[i] + carried[:3, 3]
    if errors.enabled:
        carried = carried @ _deviation(errors.tool, tool)
    return Chain(axis, point, np.array(origins), deviation, carried @ transform(HOME_TOOL_AXES, tool))


def _third(length: float, span: Array) -> float:
    """Where the hinge sits along ``span``: a third of the beam's ``length``, measured from its root."""
    return length / 3.0 / float(np.linalg.norm(span))
