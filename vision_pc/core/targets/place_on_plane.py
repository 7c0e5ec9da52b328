"""A place on a plane as a target: its frame, and what all frames of a camera are wrong in alike."""

import math

import numpy as np

from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.object_of_interest import lens_covariance
from vision_pc.core.se3 import Array
from vision_pc.core.targets import plane_patch
from vision_pc.core.targets.plane_patch import PlanePatch
from vision_pc.core.targets.sighting import Sighted
from vision_pc.core.targets.target import TargetObservation, frame_on, with_roll
from vision_pc.core.targets.wider_patch import wider
from vision_pc.core.types import CameraCalibration, StereoPair

HALF = 30  # px of a plane's patch on either side
_WIDER = (42, 56)  # px, where the normal wants more
_LENS_K1 = 0.001  # [E] of both eyes, where nobody told of one
_LENS_PX = 0.06  # disparity that such a k1 makes where the tool usually is


def plane_at(pair: StereoPair, camera: CameraCalibration, pixel: Array, inverse_depth: float) -> PlanePatch:
    """The plane about a pixel (2,), over as wide a patch as its normal wants. Raises TargetRefused."""
    plane = plane_patch.align(pair, camera, pixel, inverse_depth, HALF)
    for half in _WIDER:
        plane = wider(pair, camera, plane, pixel, half, None)
    return plane


def on_plane(sighted: Sighted, camera: CameraCalibration, plane: PlanePatch) -> TargetObservation:
    """A clicked place: where its ray meets the plane, with the plane's normal."""
    X = frame_on(plane.meet(plane.ray), plane.n)
    J = moved_by_plane(plane, plane.ray)
    bias = bias_of(sighted, X, plane)
    reach = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * HALF
    middle = intrinsics.distorted(camera.left, plane.ray[None, :2])[0]
    covariance = with_roll(J @ plane.covariance @ J.T + bias, X)
    return TargetObservation("plane", X, covariance, bias, plane.quality, middle + reach)


def moved_by_plane(plane: PlanePatch, ray: Array) -> Array:
    """How the frame where ``ray`` (3,) meets the plane changes (6, 3) with the plane's three numbers."""
    X, J = frame_on(plane.meet(ray), plane.n), np.zeros((6, 3))
    for k, step in enumerate(np.sqrt(np.diag(plane.covariance))):
        n = plane_patch.normal_of(plane.theta + step * np.eye(3)[k], plane.ray)
        J[:, k] = se3.local(X, frame_on(ray / (n @ ray), n)) / step
    return J


def bias_of(sighted: Sighted, X: Array, plane: PlanePatch) -> Array:
    """What all frames share: errors of the right eye's offset, of baseline and focal length, and of k1."""
    radial, errors = sighted.markers.radial_std, sighted.observation.errors
    if errors is not None:
        radial = math.sqrt(errors.covariance[6, 6])
    covariance = np.asarray(lens_covariance(X, sighted.markers, radial))
    ray, before = X[:3, 3] / X[2, 3], frame_on(X[:3, 3], plane.n)
    baseline_m = float(np.linalg.norm(sighted.camera.right.X_CE[:3, 3]))
    turn = radial or _LENS_K1
    others = [turn * turned_by_radial(plane.n, ray, baseline_m)]
    for offset_px, baseline in _shared_errors(sighted):
        others.append(plane.n * baseline + np.array([0.0, 0.0, offset_px * plane.offset_rate]))
    for other in others:
        n = plane.n + other
        moved = se3.local(before, frame_on(ray / (n @ ray), n))
        covariance += np.outer(moved, moved)
    return covariance


def turned_by_radial(n: Array, ray: Array, baseline_m: float) -> Array:
    """How a plane's n (3,) 1/m turns about its place on ``ray`` (z = 1) with an error of both eyes' k1.

    k1 moves what is at (x, y) by k1 r² (x, y), at x in one eye and at x − d in the other. Its gradient in the
    disparity d = baseline n·(x, y, 1) is a turn: 3 k1 (2 x − d) for a plane that faces the camera.
    """
    (x, y, _), d = ray, baseline_m * float(n @ ray)
    (d_x, d_y, _), other = baseline_m * n, x - d
    g_x = 3.0 * (1.0 - d_x) * (x**2 - other**2) - 2.0 * x * y * d_y
    g_y = 2.0 * y * (d - x * d_x) + d_y * (3.0 * other**2 - x**2 - 2.0 * y**2)
    return np.array([g_x, g_y, -g_x * x - g_y * y]) / baseline_m


def _shared_errors(sighted: Sighted) -> list[tuple[float, float]]:
    """Independent errors, 1 σ: each the right eye's offset (px) and the baseline's share that go together.

    The markers tell the offset by their size: a print or a baseline that is off by a share stands for a
    disparity that is off by that share of the marker's, and frames do not average it out.
    """
    observation, markers = sighted.observation, sighted.markers
    if observation.errors is not None:
        pair = observation.errors.covariance[np.ix_([0, 2], [0, 2])]
        (a, _), (b, c) = np.linalg.cholesky(pair + np.diag([1e-18, 1e-18]))
        return [(float(a), float(b)), (0.0, float(c))]
    std_px = markers.offset_std_px if observation.offset is None else observation.offset.std_x_px
    seen = [X for X in (observation.X_CM, observation.X_CO) if X is not None]
    base = markers.calibration.baseline
    if not seen:
        return [(std_px, 0.0), (0.0, base)]
    camera = sighted.camera
    rate = float(camera.left.K[0, 0] * np.linalg.norm(camera.right.X_CE[:3, 3]))
    disparities = np.array([rate / X[2, 3] for X in seen])
    weights = disparities**-2.0 / (disparities**-2.0).sum()
    print_px = markers.print_size_std * float((disparities**-2.0).sum()) ** -0.5
    own_px = math.sqrt(max(std_px**2 - print_px**2, markers.offset_floor_px**2))
    return [(own_px, 0.0), (_LENS_PX, 0.0), (print_px, 0.0), (-float(weights @ disparities) * base, base)]
