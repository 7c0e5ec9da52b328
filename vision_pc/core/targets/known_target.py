"""A target that is known already, measured once more."""

import math

import numpy as np

from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.core.targets import row_matching
from vision_pc.core.targets.circle_hole import dark_spots
from vision_pc.core.targets.measuring import measured_hole
from vision_pc.core.targets.place_on_plane import on_plane, plane_at
from vision_pc.core.targets.sighting import KnownTarget, Sighted, region, visible
from vision_pc.core.targets.target import TargetObservation, TargetRefused
from vision_pc.core.types import CameraCalibration

_DEPTH_SHARE = 0.15  # by which the depth of a known target may have changed
_AGAIN_M = 0.02  # how far a known target may lie from where it is expected, besides three standard deviations


def again(sighted: Sighted, known: KnownTarget) -> TargetObservation:
    """A known target measured once more, its axes turned as little as its normal asks for.

    Raises TargetRefused: ``target.outside_picture``, ``target.hidden`` behind the tool, ``target.not_found``
    where it is expected, and as ``at_click``.
    """
    camera = sighted.believed
    p = known.X_CO[:3, 3]
    pixel = visible(sighted, camera, known)
    depths = float(p[2]) * (1.0 - _DEPTH_SHARE), float(p[2]) * (1.0 + _DEPTH_SHARE)
    if known.kind == "plane":
        inverse_depth = row_matching.match(sighted.pair, camera, pixel, depths)
        plane = plane_at(sighted.pair, camera, pixel, inverse_depth)
        seen = _with_known_place(on_plane(sighted, camera, plane), known)
    else:
        seen = _hole_again(sighted, camera, known, pixel, depths)
    off = float(np.linalg.norm(seen.X_CO[:3, 3] - p))
    limit = _AGAIN_M + 3.0 * math.sqrt(float(np.trace(known.covariance[:3, :3])))
    if off > limit:
        raise TargetRefused(
            "target.not_found",
            f"target: found {1e3 * off:.0f} mm from where it is expected, limit {1e3 * limit:.0f} mm",
        )
    return seen._replace(X_CO=_turned_least(known.X_CO, seen.X_CO))


def _hole_again(
    sighted: Sighted, camera: CameraCalibration, known: KnownTarget, pixel: Array, depths: tuple[float, float]
) -> TargetObservation:
    assert known.diameter_m is not None  # of a hole
    radius = 0.5 * known.diameter_m * float(camera.left.K[0, 0]) / float(known.X_CO[2, 3])
    spread = 3.0 * math.sqrt(float(np.trace(known.covariance[:3, :3]))) + _AGAIN_M
    reach = int(spread * camera.left.K[0, 0] / known.X_CO[2, 3] + 3.0 * radius) + 8
    spots = dark_spots(sighted.pair.left, region(pixel[0], pixel[1], reach, camera))
    for spot in sorted(spots, key=lambda spot: float(np.linalg.norm(spot.middle - pixel))):
        try:
            return measured_hole(sighted, camera, spot, depths, 1e3 * known.diameter_m)
        except TargetRefused:
            continue
    raise TargetRefused("target.not_found", "target: no hole where it is expected")


def _with_known_place(seen: TargetObservation, known: KnownTarget) -> TargetObservation:
    """A place on a surface measured again: along its ray anew, across it known no better than before."""
    ray = seen.X_CO[:3, 3] / np.linalg.norm(seen.X_CO[:3, 3])
    across = np.eye(3) - np.outer(ray, ray)
    shared = np.zeros((6, 6))
    shared[:3, :3] = across @ known.covariance[:3, :3] @ across
    return seen._replace(covariance=seen.covariance + shared, bias=seen.bias + shared)


def _turned_least(known: Array, seen: Array) -> Array:
    """``seen`` with the axes of ``known``, turned by no more than brings z upon z."""
    a, b = known[:3, 2], seen[:3, 2]
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return se3.transform(known[:3, :3], seen[:3, 3])
    turn = axis / sine * math.atan2(sine, float(a @ b))
    return se3.transform(se3.exp_so3(turn) @ known[:3, :3], seen[:3, 3])
