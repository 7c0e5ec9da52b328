"""Targets measured: at a click, all holes of a picture, and one that is known already once more."""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from vision_pc.config.targets import TargetSettings
from vision_pc.config.vision import MarkerSettings
from vision_pc.core import se3
from vision_pc.core.odometry.moving_regions import static_pixels
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.camera_correction import as_believed
from vision_pc.core.perception.object_of_interest import lens_covariance
from vision_pc.core.se3 import Array
from vision_pc.core.targets import (
    circle_hole,
    free_rim,
    plane_patch,
    row_matching,
    template_search,
    template_target,
)
from vision_pc.core.targets.hole_search import dark_spots
from vision_pc.core.targets.plane_patch import PlanePatch
from vision_pc.core.targets.round_edge import DarkSpot
from vision_pc.core.targets.target import Kind, TargetObservation, TargetRefused, Taught, frame_on, with_roll
from vision_pc.core.targets.wider_patch import wider
from vision_pc.core.types import CameraCalibration, FrameObservation, StereoPair

_HALF = 30  # px of a plane's patch on either side
_WIDER = (42, 56)  # px, where the normal wants more
_CLICK_REACH = 70  # px about a click in which a hole may reach it
_INSIDE = 1.4  # radii from a hole's middle at which a click still means it
_DEPTH_SHARE = 0.15  # by which the depth of a known target may have changed
_AGAIN_M = 0.02  # how far a known target may lie from where it is expected, besides three standard deviations
_HIDDEN_RADIUS_PX = 12
_LENS_PX = 0.06  # [E] disparity that a k1 of 0.001, which nobody told of, makes where the tool usually is
_SECOND_CLICK = 0.06  # share of the depth by which a click in the other eye may be off


class Sighted(NamedTuple):
    """A pair with what is believed of its camera: markers' ``observation``, and the settings."""

    pair: StereoPair
    camera: CameraCalibration
    observation: FrameObservation
    markers: MarkerSettings
    settings: TargetSettings

    @property
    def believed(self) -> CameraCalibration:
        """The camera with all that markers have told of it."""
        return as_believed(self.camera, self.observation)


class Click(NamedTuple):
    """A place in one eye's picture, px; ``other``: the same in the other eye, where one is not enough.

    ``size_px``: of a template, how wide what is taught is.
    """

    eye: Literal["left", "right"]
    pixel: Array
    kind: Literal["auto", "plane", "hole", "template"] = "auto"
    diameter_mm: float | None = None
    other: Array | None = None
    size_px: int | None = None


class KnownTarget(NamedTuple):
    """A target as it is believed to be: X_CO with its covariance (6, 6)."""

    kind: Kind
    X_CO: Array
    covariance: Array
    diameter_m: float | None
    taught: Taught | None = None


def at_click(sighted: Sighted, click: Click) -> TargetObservation:
    """The target that is meant by a click. Raises TargetRefused with its cause."""
    if click.kind == "template":
        return _taught(sighted, click)
    if click.eye == "right":
        return _at_left_again(sighted, click)
    pair, camera = sighted.pair, sighted.believed
    row_matching.refuse_outside(click.pixel, camera)
    _refuse_hidden(sighted, camera, (click.pixel,), 0)
    depths = sighted.settings.depths_m
    if click.other is not None:
        depth = row_matching.depth_of(camera, click.pixel, click.other)
        depths = depth * (1.0 - _SECOND_CLICK), depth * (1.0 + _SECOND_CLICK)
    if click.kind != "plane":
        hole = _hole_at(sighted, camera, click, depths)
        if hole is not None:
            return hole
    found = row_matching.match(pair, camera, click.pixel, depths)
    return _on_plane(sighted, camera, _plane(pair, camera, click.pixel, found.inverse_depth))


def holes(sighted: Sighted, diameter_mm: float | None = None) -> list[TargetObservation]:
    """All holes of the configured diameter in the picture, from left to right."""
    camera, found = sighted.believed, list[TargetObservation]()
    for spot in dark_spots(sighted.pair.left):
        try:
            hole = _measured_hole(sighted, camera, spot, sighted.settings.depths_m, diameter_mm)
        except TargetRefused:
            continue
        if not any(_one_hole(hole, other) for other in found):  # the whole of it may be a spot, and a part
            found.append(hole)
    return sorted(found, key=lambda hole: float(hole.X_CO[0, 3] / hole.X_CO[2, 3]))


def _one_hole(one: TargetObservation, other: TargetObservation) -> bool:
    apart = float(np.linalg.norm(one.X_CO[:3, 3] - other.X_CO[:3, 3]))
    return apart < 0.5 * (one.diameter_m or 0.0)


def again(sighted: Sighted, known: KnownTarget) -> TargetObservation:
    """A known target measured once more, its axes turned as little as its normal asks for.

    Raises TargetRefused: ``target.outside_picture``, ``target.hidden`` behind the tool, ``target.not_found``
    where it is expected, and as ``at_click``.
    """
    camera = sighted.believed
    p = known.X_CO[:3, 3]
    if known.taught is not None:
        return _found_again(sighted, known.taught, known)
    pixel = _visible(sighted, camera, known)
    depths = float(p[2]) * (1.0 - _DEPTH_SHARE), float(p[2]) * (1.0 + _DEPTH_SHARE)
    if known.kind == "plane":
        found = row_matching.match(sighted.pair, camera, pixel, depths)
        plane = _plane(sighted.pair, camera, pixel, found.inverse_depth)
        seen = _with_known_place(_on_plane(sighted, camera, plane), known)
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


def anywhere(sighted: Sighted, known: KnownTarget) -> TargetObservation:
    """A template found anywhere in the left picture, whatever was believed of its place.

    Raises TargetRefused: ``target.not_taught`` for a target of another kind, ``target.not_found``,
    ``target.ambiguous``, and as ``at_click``.
    """
    if known.taught is None:
        raise TargetRefused("target.not_taught", "target: only a template is found again by its looks")
    return _found_again(sighted, known.taught, known, everywhere=True)


def _taught(sighted: Sighted, click: Click) -> TargetObservation:
    """The surface at a click, and what it looks like."""
    seen = at_click(sighted, click._replace(kind="plane"))
    eye, half = sighted.believed.left, (click.size_px or 2 * _HALF) // 2
    taught = template_target.teach(sighted.pair.left, eye, seen.X_CO, half)
    return seen._replace(
        kind="template", taught=taught, outline=template_target.outline(eye, taught, seen.X_CO)
    )


def _found_again(
    sighted: Sighted, taught: Taught, known: KnownTarget, everywhere: bool = False
) -> TargetObservation:
    """A template where it lies now; within the picture's rest it was expected, or ``everywhere``."""
    camera, expected, reach = sighted.believed, known.X_CO, None
    if not everywhere:
        _visible(sighted, camera, known)
        spread = 3.0 * math.sqrt(float(np.trace(known.covariance[:3, :3]))) + _AGAIN_M
        reach = int(spread * camera.left.K[0, 0] / expected[2, 3]) + 4
    place = template_search.find(sighted.pair.left, camera.left, taught, expected, reach)
    found = row_matching.match(sighted.pair, camera, place.pixel, sighted.settings.depths_m)
    plane = _plane(sighted.pair, camera, place.pixel, found.inverse_depth)
    laid = template_target.lay(sighted.pair.left, camera.left, taught, plane, place)
    on_plane, bias = _on_plane(sighted, camera, plane), _bias(sighted, laid.X, plane)
    in_plane = np.zeros((6, 3))
    in_plane[:3, :2], in_plane[3:, 2] = laid.X[:3, :2], laid.X[:3, 2]
    shifted = in_plane @ laid.covariance @ in_plane.T
    J = _moved_by_plane(plane)
    bias += 0.5 * shifted  # what was taught is noisy too, in every frame alike
    return on_plane._replace(
        kind="template",
        X_CO=laid.X,
        covariance=J @ plane.covariance @ J.T + 0.5 * shifted + bias + 1e-10 * np.eye(6),
        bias=bias,
        quality=laid.correlation,
        outline=template_target.outline(camera.left, taught, laid.X),
        taught=taught,
    )


def _plane(pair: StereoPair, camera: CameraCalibration, pixel: Array, inverse_depth: float) -> PlanePatch:
    plane = plane_patch.align(pair, camera, pixel, inverse_depth, _HALF)
    for half in _WIDER:
        plane = wider(pair, camera, plane, pixel, half, None)
    return plane


def _hole_at(
    sighted: Sighted, camera: CameraCalibration, click: Click, depths: tuple[float, float]
) -> TargetObservation | None:
    """The hole under a click. None where none is, unless a hole was asked for."""
    u, v = click.pixel
    region = _region(u, v, _CLICK_REACH, camera)
    spots = [
        spot
        for spot in dark_spots(sighted.pair.left, region)
        if np.linalg.norm(spot.middle - click.pixel) < _INSIDE * spot.radius + 3.0
    ]
    why: TargetRefused | None = None
    for spot in sorted(spots, key=lambda spot: float(np.linalg.norm(spot.middle - click.pixel))):
        try:
            return _measured_hole(sighted, camera, spot, depths, click.diameter_mm)
        except TargetRefused as refused:
            why = why or refused
    if click.kind == "hole":
        raise why or TargetRefused("target.no_hole", f"target: no dark round spot at ({u:.0f}, {v:.0f}) px")
    return None


def _measured_hole(
    sighted: Sighted,
    camera: CameraCalibration,
    spot: DarkSpot,
    depths: tuple[float, float],
    diameter_mm: float | None,
) -> TargetObservation:
    diameters = sighted.settings.diameters_m(diameter_mm)
    try:
        hole = circle_hole.measure(sighted.pair, camera, spot, depths, diameters)
    except TargetRefused as refused:
        try:
            hole = free_rim.measure(sighted.pair, camera, spot, depths, diameters)
        except TargetRefused:
            raise refused from None
    bias = _bias(sighted, hole.X_CO, hole.plane)
    covariance = with_roll(hole.covariance + bias, hole.X_CO)
    return TargetObservation(
        "hole", hole.X_CO, covariance, bias, hole.plane.quality, hole.outline, hole.diameter_m
    )


def _hole_again(
    sighted: Sighted, camera: CameraCalibration, known: KnownTarget, pixel: Array, depths: tuple[float, float]
) -> TargetObservation:
    assert known.diameter_m is not None  # of a hole
    radius = 0.5 * known.diameter_m * float(camera.left.K[0, 0]) / float(known.X_CO[2, 3])
    spread = 3.0 * math.sqrt(float(np.trace(known.covariance[:3, :3]))) + _AGAIN_M
    reach = int(spread * camera.left.K[0, 0] / known.X_CO[2, 3] + 3.0 * radius) + 8
    spots = dark_spots(sighted.pair.left, _region(pixel[0], pixel[1], reach, camera))
    for spot in sorted(spots, key=lambda spot: float(np.linalg.norm(spot.middle - pixel))):
        try:
            return _measured_hole(sighted, camera, spot, depths, 1e3 * known.diameter_m)
        except TargetRefused:
            continue
    raise TargetRefused("target.not_found", "target: no hole where it is expected")


def _visible(sighted: Sighted, camera: CameraCalibration, known: KnownTarget) -> Array:
    """The left eye's pixel (2,) of a known target. Raises TargetRefused where either eye cannot see it."""
    pixels = [intrinsics.project(eye, known.X_CO[None, :3, 3])[0] for eye in (camera.left, camera.right)]
    for pixel in pixels:
        row_matching.refuse_outside(pixel, camera)
    _refuse_hidden(sighted, camera, pixels, _HIDDEN_RADIUS_PX)
    return np.asarray(pixels[0])


def _refuse_hidden(
    sighted: Sighted, camera: CameraCalibration, pixels: Sequence[Array], radius_px: int
) -> None:
    """Raises TargetRefused where an eye sees the tool at its pixel (2,); ``pixels``: the left eye's first."""
    X_CM = sighted.observation.X_CM
    if X_CM is None:
        return
    for mask, pixel in zip(static_pixels(X_CM, sighted.markers.tool, camera), pixels, strict=False):
        left, top, right, bottom = _region(pixel[0], pixel[1], radius_px, camera)
        if not mask[top:bottom, left:right].all():
            raise TargetRefused("target.hidden", "target: the tool is before it")


def _on_plane(sighted: Sighted, camera: CameraCalibration, plane: PlanePatch) -> TargetObservation:
    """A clicked place: where its ray meets the plane, with the plane's normal."""
    X = frame_on(plane.meet(plane.ray), plane.n)
    J = _moved_by_plane(plane)
    bias = _bias(sighted, X, plane)
    reach = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * _HALF
    middle = intrinsics.distorted(camera.left, plane.ray[None, :2])[0]
    covariance = with_roll(J @ plane.covariance @ J.T + bias, X)
    return TargetObservation("plane", X, covariance, bias, plane.quality, middle + reach)


def _moved_by_plane(plane: PlanePatch) -> Array:
    """How the frame on the plane (6,) changes with the plane's three numbers."""
    X, J = frame_on(plane.meet(plane.ray), plane.n), np.zeros((6, 3))
    for k, step in enumerate(np.sqrt(np.diag(plane.covariance))):
        n = plane_patch.normal_of(plane.theta + step * np.eye(3)[k], plane.ray)
        J[:, k] = se3.local(X, frame_on(plane.ray / (n @ plane.ray), n)) / step
    return J


def _bias(sighted: Sighted, X: Array, plane: PlanePatch) -> Array:
    """What all frames share: errors of the right eye's offset, of baseline and focal length, and of k1."""
    radial, errors = sighted.markers.radial_std, sighted.observation.errors
    if errors is not None:
        radial = math.sqrt(errors.covariance[6, 6])
    covariance = np.asarray(lens_covariance(X, sighted.markers, radial))
    ray, before = X[:3, 3] / X[2, 3], frame_on(X[:3, 3], plane.n)
    for offset_px, baseline in _shared_errors(sighted):
        n = plane.n * (1.0 + baseline) + np.array([0.0, 0.0, offset_px * plane.offset_rate])
        moved = se3.local(before, frame_on(ray / (n @ ray), n))
        covariance += np.outer(moved, moved)
    return covariance


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


def _region(u: float, v: float, reach: int, camera: CameraCalibration) -> tuple[int, int, int, int]:
    return (
        max(int(u) - reach, 0),
        max(int(v) - reach, 0),
        min(int(u) + reach + 1, camera.width),
        min(int(v) + reach + 1, camera.height),
    )


def _at_left_again(sighted: Sighted, click: Click) -> TargetObservation:
    """A click in the right picture: measured with the eyes exchanged, told in C."""
    camera = sighted.camera
    X_CR = camera.right.X_CE
    exchanged = camera._replace(
        left=camera.right._replace(X_CE=se3.identity()),
        right=camera.left._replace(X_CE=se3.inverse(X_CR)),
    )
    offset = sighted.observation.offset
    if offset is not None:
        believed = sighted.believed
        exchanged = exchanged._replace(
            left=believed.right._replace(X_CE=se3.identity()),
            right=believed.left._replace(X_CE=se3.inverse(believed.right.X_CE)),
        )
    pair = sighted.pair._replace(left=sighted.pair.right, right=sighted.pair.left)
    X_CM = sighted.observation.X_CM
    told = sighted.observation._replace(
        X_CM=None if X_CM is None else se3.inverse(X_CR) @ X_CM,
        errors=None,
        offset=offset and offset._replace(x_px=0.0, y_px=0.0),
    )
    seen = at_click(
        sighted._replace(pair=pair, camera=exchanged, observation=told), click._replace(eye="left")
    )
    return _told_in(seen, X_CR, camera)


def _told_in(seen: TargetObservation, X_CR: Array, camera: CameraCalibration) -> TargetObservation:
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = X_CR[:3, :3]
    p = se3.apply(X_CR, seen.X_CO[None, :3, 3])[0]
    X = frame_on(p, X_CR[:3, :3] @ seen.X_CO[:3, 2])
    moved = intrinsics.project(camera.left, p[None])[0] - seen.outline.mean(axis=0)
    return seen._replace(
        X_CO=X,
        covariance=turn @ seen.covariance @ turn.T,
        bias=turn @ seen.bias @ turn.T,
        outline=seen.outline + moved,
    )
