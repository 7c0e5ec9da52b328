"""Plain data of the vision side: images, cameras, observations, looks and samples along a path.

Poses are 4×4 arrays named in the monogram way. Every covariance is 6×6 of ``se3.retract``'s perturbation
[δp; δθ] in the outer frame's axes, m² and rad². Times are nanoseconds on the vision PC's monotonic clock.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vision_pc.core.se3 import Array

Image = NDArray[np.uint8]


class CameraFrame(Protocol):
    """One exposure of the camera: its number and its time. What it shows is the business of a sensor."""

    @property
    def capture_ns(self) -> int: ...
    @property
    def frame_id(self) -> int: ...


class StereoPair(NamedTuple):
    """A ``CameraFrame`` with pixels: one grey picture of each eye, (height, width) uint8, exposed together at
    ``capture_ns``.
    """

    left: Image
    right: Image
    capture_ns: int
    frame_id: int


class CameraModel(NamedTuple):
    """A pinhole with Brown-Conrady distortion.

    ``K`` (3×3) px; ``distortion`` (5,) = k1 k2 p1 p2 k3, zeros for rectified pictures; ``X_CE`` this eye
    in C (C is the left eye: identity there).
    """

    K: Array
    distortion: Array
    X_CE: Array


class CameraCalibration(NamedTuple):
    """Both eyes and the picture size. Built by ``intrinsics.calibration``."""

    width: int
    height: int
    left: CameraModel
    right: CameraModel


class MarkerObservation(NamedTuple):
    """One marker in one pair.

    ``corners_left``/``corners_right`` (4, 2) distorted pixels in ArUco's order, right None where not found;
    ``X_CA`` the marker's own frame in C, from this marker alone; ``residual_px`` its rms reprojection error;
    ``flip_margin`` by how much χ² of the other planar solution is larger (below about 9: ambiguous).
    """

    marker_id: int
    size: float
    corners_left: Array
    corners_right: Array | None
    X_CA: Array
    covariance: Array
    residual_px: float
    flip_margin: float


class StereoOffset(NamedTuple):
    """How much the right eye's rows and columns are off the calibration, px (right picture minus model)."""

    x_px: float
    y_px: float
    std_x_px: float
    std_y_px: float


class CameraErrors(NamedTuple):
    """How a camera differs from its calibration: ``values`` (12,) and their ``covariance``.

    In order: the right eye's offset (x, y px), the baseline's relative error, how much longer the right
    eye's focal lengths are (x, y px), its turn about its axis (rad), k1 of both eyes, how much more k1, p1
    and p2 the right one has, k2 of both eyes, and how much more the right one has.
    """

    values: Array
    covariance: Array

    @property
    def offset(self) -> StereoOffset:
        """The right eye's offset alone."""
        stds = np.sqrt(np.diag(self.covariance)[:2])
        return StereoOffset(float(self.values[0]), float(self.values[1]), float(stds[0]), float(stds[1]))


class MisplacedMarker(NamedTuple):
    """A marker of the object that the others contradict: ``off_m`` (2,), m, in x and y of O, is where it is
    seen less where the configuration has it, ``std_m`` (2,) what hanging and printing explain.
    """

    marker_id: int
    off_m: Array
    std_m: Array

    def __str__(self) -> str:
        x, y = 1e3 * self.off_m
        return (
            f"marker {self.marker_id} is seen {1e3 * math.hypot(*self.off_m):.1f} mm from where the others "
            f"and markers.object put it (x {x:+.1f} mm, y {y:+.1f} mm): measure its x_m and y_m again"
        )


class FrameObservation(NamedTuple):
    """What one pair shows. A pose that was not measured is None, never a zero.

    ``cov_*`` is the whole covariance, ``bias_*`` the part of it that consecutive frames share
    (rectification offset, print size) and that averaging does not remove. ``rejected`` counts what was seen
    and refused, by cause (``unknown_id``, ``repeated_id``, ``edges``, ``residual``, ``wrong_size``,
    ``ambiguous``). ``missing_*`` says why a pose is None: ``wrong_size``, ``seen_twice``,
    ``ambiguous`` or ``not_seen``.
    ``errors`` of the camera, once they were found: then the offset is no longer learnt frame by frame.
    ``misplaced``: the marker that the others contradict.
    """

    capture_ns: int
    frame_id: int
    X_CM: Array | None
    cov_CM: Array | None
    bias_CM: Array | None
    X_CO: Array | None
    cov_CO: Array | None
    bias_CO: Array | None
    markers: tuple[MarkerObservation, ...]
    rejected: Mapping[str, int]
    offset: StereoOffset | None
    missing_tool: str | None = None
    missing_object: str | None = None
    since_full_search: int = 0
    errors: CameraErrors | None = None
    misplaced: MisplacedMarker | None = None


class Contradiction(NamedTuple):
    """``what`` was seen ``shift_m`` and ``turn_rad`` from where it must be, by the look of ``time_ns``, and
    nobody has answered that since (``positioning.doubt``).
    """

    what: str
    shift_m: float
    turn_rad: float
    time_ns: int

    def variance_m2(self, tolerance_m: float) -> float:
        """Of where the object is next: it may go as far again, at least out of the tolerance."""
        return max(self.shift_m, tolerance_m) ** 2

    def __str__(self) -> str:
        thing = "the object" if self.what == "object" else "the tool's marker"
        why = "does it move?" if self.what == "object" else "was it or the camera touched?"
        return (
            f"{thing} was seen {1e3 * self.shift_m:.1f} mm and {math.degrees(self.turn_rad):.2f}° "
            f"from where it was expected: {why}"
        )


class Look(NamedTuple):
    """Several pairs at rest combined robustly, with the controller's own X_BT at that time.

    ``frames`` pairs were tried; ``failed_tool`` / ``failed_object`` did not show the tool / the object;
    ``cov_CM`` / ``cov_CO`` are of the combined pose, ``frame_cov_*`` of one frame's noise. ``std_*`` are
    square roots of their diagonals: ``_m`` per axis of C in metres, ``_rad`` about the axes of C. ``X_BT`` is
    NaN where nothing says where the arm is: nothing can be computed from it. ``misplaced``: the marker whose
    place most of the frames question. ``doubt``: what stands in doubt of tool and object.
    """

    time_ns: int
    X_CM: Array
    X_CO: Array
    X_BT: Array
    frames: int
    failed_tool: int
    failed_object: int
    cov_CM: Array
    cov_CO: Array
    frame_cov_CM: Array
    frame_cov_CO: Array
    offset: StereoOffset | None
    misplaced: MisplacedMarker | None = None
    doubt: Contradiction | None = None

    @property
    def std_tool_m(self) -> Array:
        """Standard deviations (3,) of the tool's place."""
        return _deviations(self.cov_CM)[:3]

    @property
    def std_tool_rad(self) -> Array:
        """Standard deviations (3,) of the tool's orientation."""
        return _deviations(self.cov_CM)[3:]

    @property
    def std_object_m(self) -> Array:
        """Standard deviations (3,) of the object's place."""
        return _deviations(self.cov_CO)[:3]

    @property
    def std_object_rad(self) -> Array:
        """Standard deviations (3,) of the object's orientation."""
        return _deviations(self.cov_CO)[3:]


def _deviations(covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.diag(covariance)))


class PointPairs(NamedTuple):
    """Points of one pair that both eyes see, ``left`` and ``right`` (n, 2) distorted px."""

    left: Array
    right: Array


class OdometryPose(NamedTuple):
    """The camera's pose in the first camera frame, from one pair, and how well it is known.

    ``covariance`` (6×6): of [δp; δθ] in C0, with the errors of the path so far. ``pairs``: the points that
    hold it and that both eyes see.
    """

    capture_ns: int
    frame_id: int
    X_C0C: Array
    covariance: Array
    inliers: int
    coverage: float
    residual_px: float
    pairs: PointPairs | None = None


class WatchSample(NamedTuple):
    """One pair along a path: X_BT at its capture, odometry and markers where wanted and measured.

    ``observation`` and ``pairs``: where both were wanted, all that the pair shows.
    """

    time_ns: int
    X_BT: Array
    X_C0C: Array | None
    X_CM: Array | None
    X_CO: Array | None
    observation: FrameObservation | None = None
    pairs: PointPairs | None = None


class WatchHealth(NamedTuple):
    """Counts over a watch: ``frames`` were processed; the others say in how many something wanted was
    missing.

    ``offset`` is the right eye's offset that was believed last, None if no marker ever told.
    """

    frames: int
    odometry_lost: int
    tool_missed: int
    object_missed: int
    median_inliers: int
    last_loss: str | None
    offset: StereoOffset | None = None
