"""What computations need of the nominal arm, derived once from its description: SI units, no YAML types."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nominal_arm.description import NominalArm

_LIFT_PIVOT, _BOOM, _ELBOW, _FOREARM, _TOOL = 0, 1, 2, 3, 5  # rows of Table 1


class DhLink(NamedTuple):
    """One link, Rz(theta) Tz(d) Tx(a) Rx(alpha) with theta = q + theta_offset; radians and metres."""

    alpha: float
    a: float
    theta_offset: float
    d: float


class BoomDimensions(NamedTuple):
    """The boom in its slewing plane, metres.

    ``lift_pivot`` (forward, up) in B; ``boom`` from there to the tilt's pivot, ``forearm`` from there to the
    wrist's centre, both straight lines; ``wrist_to_tool`` from there to the TCP along the tool's z axis.
    """

    lift_pivot: tuple[float, float]
    boom: float
    forearm: float
    wrist_to_tool: float


class Dimensions(NamedTuple):
    """All that a program needs of the arm's geometry."""

    links: tuple[DhLink, ...]
    boom: BoomDimensions


def dimensions(arm: NominalArm) -> Dimensions:
    """The links and the boom of ``arm``."""
    return Dimensions(dh_links(arm), boom_dimensions(arm))


def joint_ranges(arm: NominalArm) -> dict[str, tuple[float, float]]:
    """The lower and upper bound of each joint by its name, rad."""
    return {
        joint.name: (math.radians(joint.lower_deg), math.radians(joint.upper_deg)) for joint in arm.joints
    }


def dh_links(arm: NominalArm) -> tuple[DhLink, ...]:
    """The seven links of Mäkinen et al. 2023, Table 1; the last is a mock link without a joint."""
    return tuple(
        DhLink(math.radians(row.alpha_deg), row.a_m, math.radians(row.theta_offset_deg), row.d_m)
        for row in arm.dh
    )


def boom_dimensions(arm: NominalArm) -> BoomDimensions:
    """The boom of the arm's structure.

    Between tilt and wrist the chain steps a₃ across and d₄ along, so that they are √(a₃² + d₄²) apart. Of the
    last links d₆ alone is not zero; the tool's z axis, after the mock link, points against it.
    """
    dh = arm.dh
    pivot = (dh[_LIFT_PIVOT].a_m, dh[_LIFT_PIVOT].d_m)
    forearm = math.hypot(dh[_ELBOW].a_m, dh[_FOREARM].d_m)
    return BoomDimensions(pivot, abs(dh[_BOOM].a_m), forearm, -dh[_TOOL].d_m)


def skeleton(links: tuple[DhLink, ...], q: tuple[float, ...]) -> NDArray[np.float64]:
    """Points (n + 1, 3) in B, m: the base's origin, then that of each link's frame; the last is the TCP.

    ``q`` (rad) are the joints; links beyond them stand still. Each link is Rz(θ) Tz(d) Tx(a) Rx(α)
    (Mäkinen et al. 2023, Table 1).
    """
    X = np.eye(4)
    points = [X[:3, 3].copy()]
    for index, link in enumerate(links):
        angle = q[index] if index < len(q) else 0.0
        X = X @ joint_turn(angle + link.theta_offset) @ link_behind_joint(link)
        points.append(X[:3, 3].copy())
    return np.array(points)


def joint_turn(angle: float) -> NDArray[np.float64]:
    """Rz(``angle``) (4, 4), rad: the part of a link that its joint moves."""
    X = np.eye(4)
    X[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return X


def link_behind_joint(link: DhLink) -> NDArray[np.float64]:
    """Tz(d) Tx(a) Rx(alpha) (4, 4): what of a link lies behind its joint."""
    X = np.eye(4)
    ca, sa = np.cos(link.alpha), np.sin(link.alpha)
    X[1:3, 1:3] = [[ca, -sa], [sa, ca]]
    X[:3, 3] = link.a, 0.0, link.d
    return X
