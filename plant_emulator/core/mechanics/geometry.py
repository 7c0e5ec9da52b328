"""The true arm as screw axes and a home pose, from the pivots of plant.yaml and its named geometric errors.

Written without any Denavit-Hartenberg parameter: with all joints at zero, boom, arm and wrist lie along the
base's x axis and each axis is simply where the drawing puts it. An error displaces its joint and everything
behind it.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from plant_emulator.config.plant import JointErrorConfig, PlantConfig
from plant_emulator.config.structure import BeamConfig, hinge_lengths

CYLINDER = 0.0
ROTARY = 1.0


@allocation_free
def actuator_reach(
    angle: float, kind: float, base: float, lever: float, angle0: float, length0: float
) -> tuple[float, float]:
    """Piston position (m) or vane angle (rad) from its retracted end at joint ``angle``, and its slope dx/dθ.

    The slope is the lever arm of a cylinder (m/rad), and 1 for a rotary actuator.
    """
    if kind == ROTARY:
        return angle - angle0, 1.0
    reduced, sides = angle - angle0, base * lever
    length = math.sqrt(base * base + lever * lever + 2.0 * sides * math.cos(reduced))
    return length - length0, -sides * math.sin(reduced) / length


@allocation_free
def actuator_position(
    angle: float, kind: float, base: float, lever: float, angle0: float, length0: float
) -> float:
    """Piston position (m) or vane angle (rad) from its retracted end, at joint ``angle``."""
    return actuator_reach(angle, kind, base, lever, angle0, length0)[0]


@allocation_free
def actuator_lever(
    angle: float, kind: float, base: float, lever: float, angle0: float, length0: float
) -> float:
    """dx/dθ (m/rad for a cylinder, 1 for a rotary actuator) at joint ``angle``."""
    return actuator_reach(angle, kind, base, lever, angle0, length0)[1]


Array = NDArray[np.float64]

FORWARD = np.array([1.0, 0.0, 0.0])
LEFT = np.array([0.0, 1.0, 0.0])
UP = np.array([0.0, 0.0, 1.0])
HOME_TOOL_AXES = np.column_stack((-LEFT, -UP, FORWARD))  # x_T right, y_T down, z_T forward
_IDENTITY = np.eye(4)  # to be copied: that is five times as fast as making one anew


class Coordinate(NamedTuple):
    """One angle of the chain: at home its ``axis`` and a ``point`` on it, its link's ``origin``, all (3,)."""

    name: str
    axis: Array
    point: Array
    origin: Array


class Chain(NamedTuple):
    """The ``names`` of the chain's n coordinates, base first, and its screw axes at home: unit ``axis`` and
    ``point`` on it (n, 3).

    ``link_origin`` (n, 3) is the nominal origin of each body's link, ``deviation`` (n, 4, 4) carries each
    body from its nominal home to its true one, ``X_BT_home`` (4, 4) is the tool's true pose there.
    """

    names: tuple[str, ...]
    axis: Array
    point: Array
    link_origin: Array
    deviation: Array
    X_BT_home: Array


class Hinge(NamedTuple):
    """A place where a beam bends, ``along`` (m) from its root; it gives as ``length`` (m) of the beam."""

    along: float
    length: float


def beam_hinges(beam: BeamConfig, finer: tuple[float, ...] | None) -> list[Hinge]:
    """One hinge at a third of the beam, or hinges at these shares of its length, K = EI / ``length`` each.

    Either way a tip force gives deflection P L³ / 3 EI and slope P L² / 2 EI.
    """
    if finer is None:
        return [Hinge(beam.length_m / 3.0, 0.75 * beam.length_m)]
    lengths = hinge_lengths(finer)
    return [
        Hinge(beam.length_m * place, beam.length_m * length)
        for place, length in zip(finer, lengths, strict=True)
    ]


def hinges_of(config: PlantConfig) -> tuple[list[Hinge], list[Hinge]]:
    """Where boom and arm bend."""
    finer, bend = config.errors.finer_bending, config.flexibility
    boom, arm = (finer.boom_at, finer.arm_at) if finer.enabled else (None, None)
    return beam_hinges(bend.boom, boom), beam_hinges(bend.arm, arm)


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
    X = _IDENTITY.copy()
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


def _numbered(name: str, k: int) -> str:
    return name if k == 0 else f"{name}_{k + 1}"


def _beam(name: str, origin: Array, end: Array, hinges: list[Hinge]) -> list[Coordinate]:
    """The hinges of one beam, vertical and lateral each."""
    span, found = end - origin, []
    length = float(np.linalg.norm(span))
    for k, hinge in enumerate(hinges):
        point = origin + span * (hinge.along / length)
        # raising turns about −y (right-handed), lateral bending and slewing about z
        found.append(Coordinate(_numbered(f"{name}_vertical", k), -LEFT, point, origin))
        found.append(Coordinate(_numbered(f"{name}_lateral", k), UP, point, origin))
    return found


def _pivot(config: PlantConfig, joint: str, link: str, point: Array, end: Array) -> list[Coordinate]:
    """A joint of the vertical plane, with the yaw that its pin allows and the twist of pin and link.

    Pin and link twist in series, at the root: a tip torque turns the tip as far wherever the twist sits.
    """
    found, errors = [Coordinate(joint, -LEFT, point, point)], config.errors
    if errors.pin_compliance.enabled:
        found.append(Coordinate(f"{joint}_pin", UP, point, point))
    if errors.pin_compliance.enabled or errors.torsion.enabled:
        span = end - point
        found.append(Coordinate(f"{link}_twist", span / float(np.linalg.norm(span)), point, point))
    return found


def _foot(config: PlantConfig) -> list[Coordinate]:
    """What turns below the lift: a carrier that rocks, the slew, its play, the tilt of its ring."""
    errors, found = config.errors, []
    if errors.rocking_base.enabled:
        centre = np.asarray(errors.rocking_base.centre_m)
        for name, axis in (("base_roll", FORWARD), ("base_pitch", LEFT), ("base_yaw", UP)):
            found.append(Coordinate(name, axis, centre, np.zeros(3)))
    found.append(Coordinate("slew", UP, np.zeros(3), np.zeros(3)))
    if errors.loose_slew.enabled:
        found.append(Coordinate("slew_play", UP, np.zeros(3), np.zeros(3)))
    if errors.bearing_tilt.enabled:
        ring = errors.bearing_tilt.height_m * UP
        found.append(Coordinate("ring_roll", FORWARD, ring, np.zeros(3)))
        found.append(Coordinate("ring_pitch", LEFT, ring, np.zeros(3)))
    return found


def _coordinates(config: PlantConfig) -> tuple[list[Coordinate], Array]:
    """Every coordinate of the nominal arm at home, base first, and the tool's place there."""
    geometry = config.geometry
    lift = np.array([geometry.lift_pivot_m[0], 0.0, geometry.lift_pivot_m[1]])
    tilt = lift + np.array([geometry.tilt_pivot_m[0], 0.0, geometry.tilt_pivot_m[1]])
    wrist = tilt + np.array([geometry.boom_tip_m[0] + geometry.telescope_m, 0.0, geometry.boom_tip_m[1]])
    boom, arm = hinges_of(config)
    found = _foot(config)
    found += _pivot(config, "lift", "boom", lift, tilt)
    found += _beam("boom", lift, tilt, boom)
    found += _pivot(config, "tilt", "arm", tilt, wrist)
    found += _beam("arm", tilt, wrist, arm)
    for name, axis in (("wrist1", FORWARD), ("wrist2", LEFT), ("wrist3", -FORWARD)):
        found.append(Coordinate(name, axis, wrist, wrist))
    return found, wrist + geometry.tool_length_m * FORWARD


def build_chain(config: PlantConfig) -> Chain:
    """The chain's screw axes, home poses and tool pose, in base coordinates with every coordinate at zero."""
    coordinates, tool = _coordinates(config)
    n = len(coordinates)
    axis, point, deviation = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 4, 4))
    errors, carried = config.errors.geometry, np.eye(4)
    for i, home in enumerate(coordinates):
        error: JointErrorConfig | None = getattr(errors, home.name, None)
        if errors.enabled and isinstance(error, JointErrorConfig):
            carried = carried @ _deviation(error, home.point)
        deviation[i] = carried
        axis[i] = carried[:3, :3] @ home.axis
        point[i] = carried[:3, :3] @ home.point + carried[:3, 3]
    if errors.enabled:
        carried = carried @ _deviation(errors.tool, tool)
    names, origins = tuple(c.name for c in coordinates), np.array([c.origin for c in coordinates])
    return Chain(names, axis, point, origins, deviation, carried @ transform(HOME_TOOL_AXES, tool))
