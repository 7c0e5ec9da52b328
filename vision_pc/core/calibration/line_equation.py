"""Range adjustment by the line equation (Mäkinen et al. 2023, 3.2.1).

The tool draws a circle in its own n-s plane while the camera watches the distance between tool and object
in the picture plane; the circle's point nearest to the object gives the direction, its distance the rest of
the way. Depth is not treated, and a second input does not help: the direction decides.
"""

import math
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.programs import LineEquationSettings
from vision_pc.core.ports import Arm, Eyes, Report
from vision_pc.core.se3 import Array, transform
from vision_pc.core.types import WatchSample


class LineEquation(NamedTuple):
    """What the circle showed: ``p_u`` (3,) unit vector in B, ``distance_m`` d_ε,min, the reference X_BT_ref.

    ``phi`` (rad) is where on the circle the least distance lies; ``seen`` of ``samples`` showed tool and
    object.
    """

    p_u: Array
    distance_m: float
    phi: float
    X_BT_ref: Array
    samples: int
    seen: int


async def line_equation(arm: Arm, eyes: Eyes, report: Report, settings: LineEquationSettings) -> LineEquation:
    """The line equation found by one circle, with the arm driven to its reference (one input).

    Raises MeasurementFailed when the markers were not seen throughout, the object lies within the circle,
    or the step exceeds its limit. Source: Mäkinen et al. 2023, (9)-(16).
    """
    X_BT_init = (await arm.view()).X_BT  # (14) x_init
    waypoints = circle(X_BT_init, settings.radius_m, settings.points)
    report(0.05, f"circle of {settings.radius_m:g} m, {settings.points} points")
    async with eyes.watch(markers=True, odometry=False) as watch:
        await arm.follow(waypoints, segment_s=settings.segment_s)
    result = solve(watch.samples, X_BT_init, settings)
    report(0.8, f"object {settings.radius_m + result.distance_m:.3f} m off, driving")
    await arm.move_to(result.X_BT_ref)
    report(1.0, "arrived")
    return result


def circle(X_BT_init: Array, radius_m: float, points: int) -> list[Array]:
    """The ``points`` poses of the circular path, first and last at the centre, orientation held."""
    n, s, p_init = X_BT_init[:3, 0], X_BT_init[:3, 1], X_BT_init[:3, 3]  # (9)
    on_circle = [
        p_init + radius_m * math.cos(phi) * n + radius_m * math.sin(phi) * s  # (10) (11) (12)
        for phi in np.linspace(0.0, 2.0 * math.pi, points - 2)
    ]
    return [transform(X_BT_init[:3, :3], p) for p in (p_init, *on_circle, p_init)]


def solve(samples: tuple[WatchSample, ...], X_BT_init: Array, settings: LineEquationSettings) -> LineEquation:
    """The line equation from the samples of a circle about ``X_BT_init``.

    Raises MeasurementFailed: ``measurement.marker_lost``, ``.object_inside_circle``, ``.step_too_large``.
    """
    p_init, r = X_BT_init[:3, 3], settings.radius_m
    seen = [s for s in samples if s.X_CM is not None and s.X_CO is not None]
    if len(seen) < max(settings.seen_share * len(samples), 8):
        raise MeasurementFailed(
            "measurement.marker_lost",
            f"line equation: tool and object seen in {len(seen)} of {len(samples)} pictures, "
            f"share {settings.seen_share:g} is wanted",
        )
    p = np.array([s.X_BT[:3, 3] for s in seen])
    d = np.array([picture_distance(s) for s in seen])
    along_n, along_s = (p - p_init) @ X_BT_init[:3, 0], (p - p_init) @ X_BT_init[:3, 1]
    phi = np.arctan2(along_s, along_n)
    radius = np.hypot(along_n, along_s)
    on_circle = radius > 0.8 * r
    _check_coverage(phi[on_circle])
    _refuse_inside(d[radius < 0.1 * r], r)
    if settings.minimum == "fit":
        across = np.column_stack([along_n, along_s])
        p_u, d_min = _fitted_minimum(X_BT_init, across[on_circle], d[on_circle], r)
    else:
        least = int(np.argmin(d))
        p_epsilon, d_min = p[least], float(d[least])
        p_u = (p_epsilon - p_init) / np.linalg.norm(p_epsilon - p_init)  # (15)
    step = r + d_min
    if step > settings.step_limit_m:
        raise MeasurementFailed(
            "measurement.step_too_large",
            f"line equation: step {step:.3f} m, limit {settings.step_limit_m:g} m",
        )
    X_BT_ref = transform(X_BT_init[:3, :3], p_init + p_u * step)  # (16)
    angle = math.atan2(p_u @ X_BT_init[:3, 1], p_u @ X_BT_init[:3, 0])
    return LineEquation(p_u, d_min, angle, X_BT_ref, len(samples), len(seen))


def picture_distance(sample: WatchSample) -> float:
    """d_ε: the distance (m) of object and tool in the camera's x-y plane; both must have been seen."""
    if sample.X_CM is None or sample.X_CO is None:
        raise MeasurementFailed(
            "measurement.marker_lost", "line equation: tool or object not seen in this picture"
        )
    across = sample.X_CO[:2, 3] - sample.X_CM[:2, 3]
    return float(math.hypot(across[0], across[1]))  # (13)


def _check_coverage(phi: Array) -> None:
    """Raises when tool and object were out of view over more than 60° of the circle."""
    if len(phi) < 6:
        raise MeasurementFailed(
            "measurement.marker_lost", f"line equation: {len(phi)} sightings on the circle, 6 wanted"
        )
    angles = np.sort(phi)
    gap = float(np.max(np.diff(np.append(angles, angles[0] + 2.0 * math.pi))))
    if gap > math.radians(60.0):
        raise MeasurementFailed(
            "measurement.marker_lost",
            f"line equation: nothing seen over {math.degrees(gap):.0f} deg, limit 60 deg",
        )


def _fitted_minimum(X_BT_init: Array, across: Array, d: Array, r: float) -> tuple[Array, float]:
    """p_u and d_ε,min of the one point o that the distances ``d`` (N,) from ``across`` (N, 2) fit best.

    d² = ‖x‖² − 2 x·o + c is linear in o and c; x are the tool's coordinates along n and s from the centre.
    """
    rows = np.column_stack([-2.0 * across, np.ones(len(d))])
    wanted = d**2 - (across**2).sum(axis=1)
    weight = np.ones_like(d)
    o = np.zeros(3)
    for _ in range(10):
        o = np.linalg.lstsq(rows * weight[:, None], wanted * weight, rcond=None)[0].astype(np.float64)
        residual = np.abs(rows @ o - wanted)
        scale = 1.4826 * float(np.median(residual)) + 1e-9
        weight = np.sqrt(1.0 / np.maximum(1.0, residual / (1.5 * scale)))
    reach = math.hypot(o[0], o[1])
    p_u: Array = (o[0] * X_BT_init[:3, 0] + o[1] * X_BT_init[:3, 1]) / reach
    return p_u, reach - r


def _refuse_inside(d_centre: Array, r: float) -> None:
    """Raises when the object is nearer to the centre than the circle: then (16) would overshoot."""
    distance = float(np.median(d_centre)) if len(d_centre) else math.inf
    if distance < r:
        raise MeasurementFailed(
            "measurement.object_inside_circle",
            f"line equation: object {distance:.3f} m off, circle {r:g} m; use a smaller one",
        )
