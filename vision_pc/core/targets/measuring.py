"""Targets measured: at a click, and all holes of a picture."""

import numpy as np

from vision_pc.core.targets import circle_hole, row_matching
from vision_pc.core.targets.circle_hole import dark_spots
from vision_pc.core.targets.place_on_plane import bias_of, on_plane, plane_at
from vision_pc.core.targets.round_edge import DarkSpot
from vision_pc.core.targets.sighting import Click, Sighted, refuse_hidden, region
from vision_pc.core.targets.surroundings import refuse_contradicted
from vision_pc.core.targets.target import TargetObservation, TargetRefused, with_roll
from vision_pc.core.types import CameraCalibration

_CLICK_REACH = 70  # px about a click in which a hole may reach it
_INSIDE = 1.4  # radii from a hole's middle at which a click still means it
_SECOND_CLICK = 0.06  # share of the depth by which a click in the other eye may be off


def at_click(sighted: Sighted, click: Click) -> TargetObservation:
    """The target that is meant by a click. Raises TargetRefused with its cause."""
    pair, camera = sighted.pair, sighted.believed
    row_matching.refuse_outside(click.pixel, camera)
    refuse_hidden(sighted, camera, (click.pixel,), 0)
    depths = row_matching.DEPTHS_M
    if click.other is not None:
        depth = row_matching.depth_of(camera, click.pixel, click.other)
        depths = depth * (1.0 - _SECOND_CLICK), depth * (1.0 + _SECOND_CLICK)
    if click.kind != "plane":
        hole = _hole_at(sighted, camera, click, depths)
        if hole is not None:
            return refuse_contradicted(sighted, camera, click.pixel, hole)
    inverse_depth = row_matching.match(pair, camera, click.pixel, depths)
    plane = plane_at(pair, camera, click.pixel, inverse_depth)
    seen = on_plane(sighted, camera, plane)
    return seen if click.other is None else refuse_contradicted(sighted, camera, click.pixel, seen)


def holes(sighted: Sighted, diameter_mm: float | None = None) -> list[TargetObservation]:
    """All holes of the configured diameter in the picture, from left to right."""
    camera, found = sighted.believed, list[TargetObservation]()
    for spot in dark_spots(sighted.pair.left):
        try:
            hole = measured_hole(sighted, camera, spot, row_matching.DEPTHS_M, diameter_mm)
        except TargetRefused:
            continue
        if not any(_one_hole(hole, other) for other in found):  # the whole of it may be a spot, and a part
            found.append(hole)
    return sorted(found, key=lambda hole: float(hole.X_CO[0, 3] / hole.X_CO[2, 3]))


def _one_hole(one: TargetObservation, other: TargetObservation) -> bool:
    apart = float(np.linalg.norm(one.X_CO[:3, 3] - other.X_CO[:3, 3]))
    return apart < 0.5 * (one.diameter_m or 0.0)


def _hole_at(
    sighted: Sighted, camera: CameraCalibration, click: Click, depths: tuple[float, float]
) -> TargetObservation | None:
    """The hole under a click. None where none is, unless a hole was asked for."""
    u, v = click.pixel
    about = region(u, v, _CLICK_REACH, camera)
    spots = [
        spot
        for spot in dark_spots(sighted.pair.left, about)
        if np.linalg.norm(spot.middle - click.pixel) < _INSIDE * spot.radius + 3.0
    ]
    why: TargetRefused | None = None
    for spot in sorted(spots, key=lambda spot: float(np.linalg.norm(spot.middle - click.pixel))):
        try:
            return measured_hole(sighted, camera, spot, depths, click.diameter_mm)
        except TargetRefused as refused:
            why = why or refused
    if click.kind == "hole":
        raise why or TargetRefused("target.no_hole", f"target: no dark round spot at ({u:.0f}, {v:.0f}) px")
    return None


def measured_hole(
    sighted: Sighted,
    camera: CameraCalibration,
    spot: DarkSpot,
    depths: tuple[float, float],
    diameter_mm: float | None,
) -> TargetObservation:
    """The hole that a dark spot is. Raises TargetRefused."""
    diameters = sighted.settings.diameters_m(diameter_mm)
    hole = circle_hole.measure(sighted.pair, camera, spot, depths, diameters)
    bias = bias_of(sighted, hole.X_CO, hole.plane)
    covariance = with_roll(hole.covariance + bias, hole.X_CO)
    return TargetObservation(
        "hole", hole.X_CO, covariance, bias, hole.plane.quality, hole.outline, hole.diameter_m
    )
