"""Square markers in a stereo pair: found, refined, posed, and refused with a cause where they cannot be
trusted.
"""

import math
from collections import Counter
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.config.vision import MarkerSettings
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics, marker_edges, stereo_pose
from vision_pc.core.perception.stereo_pose import BodyPoses, BodyView, Priors
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, CameraModel, Image, MarkerObservation, StereoPair

Region = tuple[int, int, int, int]
"""x_min, y_min, x_max, y_max in pixels, maxima exclusive."""

AMBIGUOUS_BELOW = 9.0  # χ² between the two planar solutions: three standard deviations
_THRESHOLD_PX = 13  # [M] one window: 8.5…17 ms a frame; three windows: 21…52
_SIZE_SIGMAS = 5.0
_SUSPICIOUS = 4.0  # rms residual in corner standard deviations above which the cause is looked for
_SAME_POSE = 1e-3  # rad
_ALIKE = 0.6  # correlation of a marker's cells between the eyes; a quad displaced by two cells has 0.2
_UNIT_SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
_SAMPLES = ((np.mgrid[0:14, 0:14].T.reshape(1, -1, 2) + 0.5) / 14.0).astype(np.float32)
_DARK = 8.0  # grey levels that are told apart less and less: the sensor's noise there is as wide
_LOGARITHMS = np.rint(255.0 * np.log1p(np.arange(256) / _DARK) / np.log1p(255.0 / _DARK)).astype(np.uint8)
_CLEAR_FLIP = 20.0  # the same for the second planar solution, above which it is not pursued


class Sighting(NamedTuple):
    """A marker that passed every test, its corners in both eyes, and the planar solution X_CA that was not
    taken.
    """

    observation: MarkerObservation
    view: BodyView
    other: Array


def corner_points(size: float) -> Array:
    """Corners (4, 3) of a marker of side ``size`` in its own frame (x right, y up), in ArUco's order."""
    h = 0.5 * size
    return np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])


class Detected(NamedTuple):
    """Known markers of a picture by number, (4, 2) rough pixels (half a pixel and more), counts of refusals,
    and the known numbers that it shows more than once.
    """

    corners: dict[int, Array]
    refused: Counter[str]
    repeated: frozenset[int]


def detect(
    image: Image,
    settings: MarkerSettings,
    region: Region | None = None,
    requested: frozenset[int] | None = None,
) -> Detected:
    """Known markers in ``image``.

    Only inside ``region`` if one is given. Where one of the ``requested`` numbers (None: of all that are
    known) is not read, the picture's logarithm is searched too: where a shadow crosses a marker, its white in
    the shade is nearer to black than to white in the light, but not by its ratio. Markers of other numbers
    are counted as ``unknown_id``; a number that appears twice is trusted in neither place.
    """
    x0, y0, x1, y1 = region or (0, 0, image.shape[1], image.shape[0])
    if x1 - x0 < 16 or y1 - y0 < 16:
        return Detected({}, Counter(), frozenset())
    part, begin = image[y0:y1, x0:x1], np.array([x0, y0])
    corners, refused, repeated = _read_markers(part, settings)
    if not (settings.sizes.keys() if requested is None else requested) <= corners.keys():
        even_light = np.asarray(cv2.LUT(part, _LOGARITHMS), dtype=np.uint8)  # shade takes from all alike
        more, also_refused, also_repeated = _read_markers(even_light, settings)
        corners, refused, repeated = more | corners, refused | also_refused, repeated | also_repeated
    single = {number: quad + begin for number, quad in corners.items() if number not in repeated}
    return Detected(single, refused, frozenset(repeated))


def _read_markers(image: Image, settings: MarkerSettings) -> tuple[dict[int, Array], Counter[str], set[int]]:
    """Known markers that ``image`` shows once, counts of refusals, and the numbers shown more often."""
    found, ids, _ = _detector(settings.dictionary).detectMarkers(image)
    numbers = [] if ids is None else [int(number) for number in ids.ravel()]
    times = Counter(numbers)
    repeated = {number for number in settings.sizes if times[number] > 1}
    corners = {
        number: quad.reshape(4, 2).astype(np.float64)
        for number, quad in zip(numbers, found, strict=True)
        if number in settings.sizes and number not in repeated
    }
    unknown = sum(number not in settings.sizes for number in numbers)
    return corners, +Counter(unknown_id=unknown), repeated


@lru_cache(maxsize=8)
def _detector(dictionary: str) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = _THRESHOLD_PX
    parameters.errorCorrectionRate = 0.6  # one wrong cell of 25: a small marker's number stays readable
    parameters.perspectiveRemovePixelPerCell = 8  # so do those of a small marker that is turned
    return cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)), parameters
    )


def sight(
    pair: StereoPair,
    rough_left: dict[int, Array],
    camera: CameraCalibration,
    settings: MarkerSettings,
    priors: Priors,
) -> tuple[list[Sighting], dict[int, str]]:
    """Every marker of ``rough_left`` refined in both eyes and posed by itself, and why others were refused.

    By number: ``edges`` (an edge could not be followed), ``residual`` (it is no flat square of this size
    anywhere), ``wrong_size`` (monocular and stereo range disagree).
    """
    sightings: list[Sighting] = []
    refused: dict[int, str] = {}
    corrected = intrinsics.with_offset(camera, priors.offset.x_px, priors.offset.y_px)
    for number, rough in sorted(rough_left.items()):
        left = _refined(pair.left, rough, camera.left, number, settings)
        if left is None:
            refused[number] = "edges"
            continue
        start = planar_start(number, left, settings)
        right = _right_rays(pair, number, rough, start.poses[0], camera, corrected, settings)
        outcome = from_rays(start, right, camera, settings, priors)
        if isinstance(outcome, str):
            refused[number] = outcome
        else:
            sightings.append(outcome)
    return sightings, refused


class PlanarStart(NamedTuple):
    """What the left eye alone says of marker ``number``, seen along ``left`` (4, 2): both poses X_CA that
    explain a flat square, better one first, and their rms errors.
    """

    number: int
    left: Array
    poses: list[Array]
    errors: Array


def planar_start(number: int, left: Array, settings: MarkerSettings) -> PlanarStart:
    """Where to look for marker ``number`` in the right eye, and where to start its pose."""
    return PlanarStart(number, left, *_planar_solutions(left, settings.sizes[number]))


def from_rays(
    start: PlanarStart,
    right: Array | None,
    camera: CameraCalibration,
    settings: MarkerSettings,
    priors: Priors,
) -> Sighting | str:
    """The sighting of a marker, or why it is refused; ``right``: the right eye's rays (4, 2), if any."""
    number, left, starts, errors = start
    rays = np.stack([left, left if right is None else right])
    seen = np.stack([np.ones(4), np.full(4, float(right is not None))])
    view = BodyView(corner_points(settings.sizes[number]), rays, seen)
    doubtful = (errors[-1] - errors[0]) * camera.left.K[0, 0] < _CLEAR_FLIP * priors.corner_std_px
    return _posed(number, view, starts if doubtful else starts[:1], camera, settings, priors)


def _refined(
    image: Image, rough: Array, eye: CameraModel, number: int, settings: MarkerSettings
) -> Array | None:
    """Rays (4, 2) of a marker's corners, None where an edge cannot be followed; its edges moved back to where
    they are, if the cells tell by how much they are seen elsewhere.
    """

    def undistort(pixels: Array) -> Array:
        return intrinsics.normalised(eye, pixels)

    rays = marker_edges.refine(image, rough, undistort)
    if rays is None or not settings.finds_edge_shift:
        return rays
    seen = intrinsics.distorted(eye, rays)
    shift = marker_edges.edge_shift(image, seen, marker_edges.cells_of(settings.dictionary, number))
    return rays if shift is None else marker_edges.refine(image, seen, undistort, shift)


def _planar_solutions(rays: Array, size: float) -> tuple[list[Array], Array]:
    """Both poses X_EA that explain a flat square (Collins and Bartoli 2014), better one first, and their
    rms errors.
    """
    _, rotations, positions, errors = cv2.solvePnPGeneric(
        corner_points(size), rays, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    poses = [
        se3.transform(se3.exp_so3(r.ravel()), p.ravel()) for r, p in zip(rotations, positions, strict=True)
    ]
    return poses, np.asarray(errors, dtype=np.float64).ravel()


def _right_rays(
    pair: StereoPair,
    number: int,
    rough: Array,
    X_CA: Array,
    camera: CameraCalibration,
    corrected: CameraCalibration,
    settings: MarkerSettings,
) -> Array | None:
    """Refined rays (4, 2) in the right eye, or None: predicted from the left eye, searched along the rows
    if that fails. A prediction that a wrong size misplaced may meet a plate's rim: the pattern decides.
    """
    predicted = intrinsics.project(corrected.right, se3.apply(X_CA, corner_points(settings.sizes[number])))
    whole = bool(np.isfinite(predicted).all())
    rays = _refined(pair.right, predicted, camera.right, number, settings) if whole else None
    if rays is not None and _alike(pair, rough, intrinsics.distorted(camera.right, rays)):
        return rays
    height, width = pair.right.shape
    margin = settings.region_margin_px
    top, bottom = int(rough[:, 1].min()) - margin, int(rough[:, 1].max()) + margin
    region = (0, max(top, 0), min(int(rough[:, 0].max()) + margin, width), min(bottom, height))
    found = detect(pair.right, settings, region, frozenset({number})).corners
    if number not in found:
        return None
    return _refined(pair.right, found[number], camera.right, number, settings)


def _alike(pair: StereoPair, left: Array, right: Array) -> bool:
    """Whether the quads ``left`` and ``right`` (4, 2) px of the two pictures hold the same pattern."""
    cells = []
    for image, quad in ((pair.left, left), (pair.right, right)):
        H = cv2.getPerspectiveTransform(_UNIT_SQUARE, quad.astype(np.float32))
        at = cv2.perspectiveTransform(_SAMPLES, H)
        cells.append(cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR).ravel().astype(np.float64))
    spreads = [float(values.std()) for values in cells]
    if min(spreads) < 1.0:
        return False
    return bool(
        np.mean((cells[0] - cells[0].mean()) * (cells[1] - cells[1].mean())) > _ALIKE * math.prod(spreads)
    )


def _posed(
    number: int,
    view: BodyView,
    starts: list[Array],
    camera: CameraCalibration,
    settings: MarkerSettings,
    priors: Priors,
) -> Sighting | str:
    """The sighting, or why it is refused. ``starts``: planar solutions worth pursuing."""
    both = _ranked(view, starts, camera, priors)
    suspicious = _SUSPICIOUS * priors.corner_std_px
    if both[0].residuals_px[0] > suspicious and view.weights[1].any():
        free = stereo_pose.solve([view], both[0].X_CA, camera, priors._replace(print_size_std=1.0))
        doubt = math.hypot(free.size_stds[0], priors.print_size_std)
        if free.residuals_px[0] < suspicious and abs(free.sizes[0] - 1.0) > _SIZE_SIGMAS * doubt:
            return "wrong_size"
        view = view._replace(weights=np.stack([view.weights[0], np.zeros(4)]))  # half hidden in the right eye
        both = _ranked(view, starts, camera, priors)
    best = both[0]
    if best.residuals_px[0] > settings.residual_limit_px:
        return "residual"
    observation = MarkerObservation(
        number,
        settings.sizes[number],
        intrinsics.distorted(camera.left, view.rays[0]),
        intrinsics.distorted(camera.right, view.rays[1]) if view.weights[1].any() else None,
        best.X_CA[0],
        best.covariances[0],
        best.residuals_px[0],
        both[-1].chi2[0] - best.chi2[0] if _are_twins(both) else math.inf,
    )
    return Sighting(observation, view, both[-1].X_CA[0])


def _ranked(
    view: BodyView, starts: list[Array], camera: CameraCalibration, priors: Priors
) -> list[BodyPoses]:
    return sorted(
        (stereo_pose.solve([view], [X], camera, priors) for X in starts),
        key=lambda solution: solution.chi2[0],
    )


def _are_twins(solutions: list[BodyPoses]) -> bool:
    """Whether two different poses remain: with the right eye both starts often end in one."""
    R, S = solutions[0].X_CA[0][:3, :3], solutions[-1].X_CA[0][:3, :3]
    return se3.angle_between(R, S) > _SAME_POSE
