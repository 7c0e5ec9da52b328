"""One picture of markers as every reader reads it, judged by the true corners; what it cost."""

import importlib.util
import time
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from foundation.configuration import load
from laboratory.campaigns.campaign import Task
from laboratory.experiments.markers.rendered_tags import MarkerAspect, TagPicture, clutter, tags
from vision_pc.config.vision import MarkerSettings, VisionConfig
from vision_pc.core.perception import marker_edges, markers
from vision_pc.core.perception.picture_markers import found_markers
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

REFINEMENTS = ("none", "subpix", "contour", "apriltag")
PUPIL = "pupil"
FAMILIES = {
    "DICT_APRILTAG_36h11": "tag36h11",
    "DICT_APRILTAG_16h5": "tag16h5",
    "DICT_APRILTAG_25h9": "tag25h9",
}
_ORDER = (1, 0, 3, 2)  # its corners in ours, of the same printed marker
_CENTRE = 0.5  # px: AprilTag's pixels have their centres there, also in OpenCV's refinement of that name


class MarkerReading(NamedTuple):
    """A marker that a reader tells of, its corners (4, 2) px in ArUco's order, σ per coordinate if told."""

    number: int
    corners: Array
    std_px: float = float("nan")


Reader = Callable[[Image], list[MarkerReading]]


def readers(dictionary: str) -> dict[str, Reader]:
    """Ours and OpenCV's; AprilTag's where `pupil-apriltags` is installed and has such a family."""
    made: dict[str, Reader] = {"ours": lambda image: _ours(image, dictionary)}
    for name in REFINEMENTS:
        made[name] = _opencv(dictionary, name)
    if dictionary in FAMILIES and importlib.util.find_spec("pupil_apriltags"):
        made[PUPIL] = _pupil(FAMILIES[dictionary])
    return made


def _ours(image: Image, dictionary: str) -> list[MarkerReading]:
    return [MarkerReading(one.number, one.corners, one.std_px) for one in found_markers(image, dictionary)]


def _opencv(dictionary: str, refinement: str) -> Reader:
    """OpenCV's detector as it comes, but for its refinement."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = getattr(cv2.aruco, f"CORNER_REFINE_{refinement.upper()}")
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    detector = cv2.aruco.ArucoDetector(book, parameters)
    centre = _CENTRE if refinement == "apriltag" else 0.0

    def read(image: Image) -> list[MarkerReading]:
        quads, ids, _ = detector.detectMarkers(image)
        numbers = [] if ids is None else ids.ravel()
        return [
            MarkerReading(int(number), quad.reshape(4, 2).astype(np.float64) - centre)
            for number, quad in zip(numbers, quads, strict=True)
        ]

    return read


@lru_cache(
    maxsize=4
)  # a detector holds its family's tables, and its destructor ends the process now and then
def _pupil(family: str) -> Reader:
    """The AprilTag library at full resolution, one thread."""
    from pupil_apriltags import Detector

    detector = Detector(families=family, nthreads=1, quad_decimate=1.0)

    def read(image: Image) -> list[MarkerReading]:
        return [
            MarkerReading(int(one.tag_id), np.asarray(one.corners)[list(_ORDER)] - _CENTRE)
            for one in detector.detect(image)
        ]

    return read


AXES: dict[str, tuple[float, ...]] = {
    "side": (8, 10, 12, 14, 16, 18, 20, 25, 30, 40, 60),
    "angle": (0, 30, 45, 60, 65, 70, 75),
    "angle_small": (0, 30, 45, 60, 65),
    "blur": (0.4, 0.7, 1.0, 1.5, 2.0, 2.5, 3.0),
    "blur_small": (0.4, 0.7, 1.0, 1.3),
    "noise": (0, 2, 5, 10, 15, 20, 30),
    "noise_small": (0, 2, 5, 10, 15),
}
"""Axis → its values. The rest is as usual, but 20 px for the axes called small."""
WORDS = {
    "side": "side, px",
    "angle": "angle, °",
    "angle_small": "angle at 20 px, °",
    "blur": "σ of blur, px",
    "blur_small": "σ of blur at 20 px, px",
    "noise": "σ of noise, grey levels",
    "noise_small": "σ of noise at 20 px, grey levels",
}
EMPTY, TIME = "empty", "time"
PEERS = (*REFINEMENTS, PUPIL)
EMPTY_NOISE = (1.0, 2.0, 5.0, 10.0)
TIMED = 4  # markers in the picture of the time
_SMALL_PX, _ROUNDS = 20.0, 5
_STREAM = 0x6D61726B
_NAN = float("nan")


class MarkersSeen(NamedTuple):
    """What one reader told of a picture: markers ``found``, ``false`` ones, the sum of squared errors (px²)
    of the corners of those found; the same over the markers that ours ``shared`` with it, and of ours there.
    """

    found: float = _NAN
    false: float = _NAN
    square: float = _NAN
    shared: float = _NAN
    shared_square: float = _NAN
    ours_square: float = _NAN
    ms: float = _NAN


class LimitRow(NamedTuple):
    """One picture of ``markers`` markers, none of them on the axis ``empty``.

    ``nees``: sum over the corners found of error² over the variance told, both coordinates. ``known_ms``,
    ``tracked_ms``: CPU time of what looks at rigs, with the numbers known, without and with a picture before.
    """

    axis: str
    value: float
    seed: int
    markers: int
    ours: MarkersSeen
    none: MarkersSeen
    subpix: MarkersSeen
    contour: MarkersSeen
    apriltag: MarkersSeen
    pupil: MarkersSeen = MarkersSeen()
    nees: float = _NAN
    known_ms: float = _NAN
    tracked_ms: float = _NAN
    failure: str = ""
    cpu_s: float = _NAN


def aspect_of(axis: str, value: float) -> MarkerAspect:
    """How markers are seen at ``value`` of ``axis``."""
    name, _, small = axis.partition("_")
    aspect = MarkerAspect(side_px=_SMALL_PX) if small else MarkerAspect()
    fields = {"side": "side_px", "angle": "angle_deg", "blur": "blur_px", "noise": "noise_grey"}
    return aspect._replace(**{fields[name]: float(value)}) if name in fields else aspect


def one_picture(config_dir: Path, task: Task) -> LimitRow:
    """The picture rendered, read by everybody and judged."""
    cv2.setNumThreads(1)
    axis, value, seed = task["axis"], float(task["value"]), int(task["seed"])
    order = (*AXES, EMPTY, TIME).index(axis)
    rng = np.random.default_rng([_STREAM, seed, order, int(100 * value)])
    if axis == EMPTY:
        picture = TagPicture(clutter(MarkerAspect(noise_grey=value), rng), {})
    else:
        picture = tags(task["family"], aspect_of(axis, value), rng, *((TIMED,) if axis == TIME else ()))
    rounds = _ROUNDS if axis == TIME else 1
    told = {name: _read_timed(read, picture.image, rounds) for name, read in readers(task["family"]).items()}
    ours = told["ours"][0]
    seen = {name: judged(found, ours, picture)._replace(ms=ms) for name, (found, ms) in told.items()}
    row = LimitRow(
        axis,
        value,
        seed,
        len(picture.corners),
        ours=seen["ours"],
        none=seen["none"],
        subpix=seen["subpix"],
        contour=seen["contour"],
        apriltag=seen["apriltag"],
        pupil=seen.get(PUPIL, MarkersSeen()),
        nees=_nees(ours, picture),
    )
    if axis == TIME:
        known, tracked = _as_in_rigs(config_dir, task["family"], picture)
        row = row._replace(known_ms=known, tracked_ms=tracked)
    return row


def judged(found: Sequence[MarkerReading], ours: Sequence[MarkerReading], picture: TagPicture) -> MarkersSeen:
    """What ``found`` is worth, and ``ours`` on the markers that both found."""
    right = _right(found, picture)
    mine = _right(ours, picture)
    both = right.keys() & mine.keys()
    return MarkersSeen(
        len(right),
        len(found) - len(right),
        sum(right.values()),
        len(both),
        sum(right[number] for number in both),
        sum(mine[number] for number in both),
    )


def _right(found: Sequence[MarkerReading], picture: TagPicture) -> dict[int, float]:
    """Sum of the squared errors of the four corners, by number, of markers that are there; once each."""
    return {
        one.number: float(np.square(one.corners - picture.corners[one.number]).sum())
        for one in found
        if one.number in picture.corners and _is_there(one.corners, picture.corners[one.number])
    }


def _is_there(corners: Array, true: Array) -> bool:
    """Whether every corner is nearer to its own than to half of the shortest edge, and to 5 px."""
    shortest = float(np.linalg.norm(true - np.roll(true, 1, axis=0), axis=1).min())
    return bool(np.linalg.norm(corners - true, axis=1).max() < min(0.5 * shortest, 5.0))


def _nees(ours: Sequence[MarkerReading], picture: TagPicture) -> float:
    right = _right(ours, picture)
    return float(sum(right[one.number] / one.std_px**2 for one in ours if one.number in right))


def _read_timed(read: Reader, image: Image, rounds: int) -> tuple[list[MarkerReading], float]:
    """What is read, and the least CPU time of it in ms."""
    found = read(image) if rounds > 1 else []
    spent = []
    for _ in range(rounds):
        began = time.process_time()
        found = read(image)
        spent.append(time.process_time() - began)
    return found, 1e3 * min(spent)


def _as_in_rigs(config_dir: Path, family: str, picture: TagPicture) -> tuple[float, float]:
    """CPU ms of detection and edge lines with the numbers known: anywhere, and near where they were."""
    usual = load(VisionConfig, config_dir / "vision.yaml").markers
    tool, *others = picture.corners
    settings = usual.model_copy(
        update={
            "dictionary": family,
            "tool": usual.tool.model_copy(update={"id": tool}),
            "object": tuple(usual.object[0].model_copy(update={"id": number}) for number in others),
        }
    )
    places = np.concatenate(list(picture.corners.values()))
    low = np.maximum(places.min(axis=0) - settings.region_margin_px, 0).astype(int)
    high = (places.max(axis=0) + settings.region_margin_px).astype(int)
    region = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
    known = _read_timed(lambda image: _read_markers(image, settings, None), picture.image, _ROUNDS)
    tracked = _read_timed(lambda image: _read_markers(image, settings, region), picture.image, _ROUNDS)
    return known[1], tracked[1]


def _read_markers(
    image: Image, settings: MarkerSettings, region: markers.Region | None
) -> list[MarkerReading]:
    rough = markers.detect(image, settings, region).corners
    refined = {number: marker_edges.refine(image, quad, lambda at: at) for number, quad in rough.items()}
    return [MarkerReading(number, corners) for number, corners in refined.items() if corners is not None]
