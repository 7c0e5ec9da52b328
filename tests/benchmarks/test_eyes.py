"""What the eyes cost and how well they see, beside OpenCV's own corner refinement; `make bench` prints the
figures.
"""

from collections.abc import Callable

import cv2
import pytest

from protocol.errors import RequestRefused
from tests.benchmarks.turns import least_in_turn
from tests.support import recorded_sets
from tests.vision_pc.perception.test_watch import World
from vision_pc.config.vision import VisionConfig
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.perception import intrinsics, look, marker_edges, markers, picture_markers
from vision_pc.core.types import CameraCalibration, StereoPair

pytestmark = [
    pytest.mark.usefixtures("one_core"),
    pytest.mark.bench,
    pytest.mark.timeout(600),
]


FULL, TRACKED, ODOMETRY = 1.0, 0.5, 0.5  # times OpenCV's own


@pytest.mark.parametrize(
    ("name", "dictionary", "count"),
    [
        ("test_aruco_marker_detection.png", "DICT_4X4_250", 12),
        ("test_charuco_board_detection.jpg", "DICT_5X5_250", 17),
    ],
)
def test_every_marker_of_moveits_pictures_is_found_and_refined(
    camera: CameraCalibration, config: VisionConfig, name: str, dictionary: str, count: int
) -> None:
    """Real photographs; they are no part of the repository, and their absence is told."""
    try:
        file = recorded_sets.data_directory() / "moveit" / name
    except RequestRefused as absent:
        pytest.skip(str(absent))
    picture = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        pytest.skip(f"{name} is absent")
    board = tuple(config.markers.object[0].model_copy(update={"id": number}) for number in range(1, count))
    settings = config.markers.model_copy(update={"dictionary": dictionary, "object": board})
    found, refused, _ = markers.detect(picture, settings)
    refined = [
        marker_edges.refine(picture, quad, lambda pixels: intrinsics.normalised(camera.left, pixels))
        for quad in found.values()
    ]
    done = sum(corners is not None for corners in refined)
    print(
        f"\n{name}: {len(found)} of {count} markers found, {done} refined by edge lines,"
        f" refused {dict(refused)}"
    )
    assert set(found) == set(range(count))
    assert not refused


@pytest.fixture(scope="module")
def shipped_pair() -> StereoPair:
    return World().shot((0.0, 0.0, 0.0), 1).pair


def timed(work: Callable[[], object], plainly: Callable[[], object], limit: float) -> None:
    """``limit``: times what the same takes ``plainly`` with OpenCV."""
    least_ms, peer_ms = (1e3 * spent_s for spent_s in least_in_turn(work, plainly))
    print(f"\n{least_ms:.1f} ms; plainly with OpenCV {peer_ms:.1f} ms: {least_ms / peer_ms:.2f} of {limit:g}")
    assert least_ms < limit * peer_ms


def opencv_markers(pair: StereoPair, config: VisionConfig) -> None:
    """Markers of both eyes, their corners refined, as OpenCV's detector does it."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, config.markers.dictionary))
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)
    for picture in (pair.left, pair.right):
        assert detector.detectMarkers(picture)[1] is not None


def opencv_odometry(pair: StereoPair) -> None:
    """Corners found, followed by flow to the other eye, to the next picture and back."""
    points = cv2.goodFeaturesToTrack(pair.left, 300, 0.01, 10)
    for there in (pair.right, pair.left):
        moved, _, _ = cv2.calcOpticalFlowPyrLK(pair.left, there, points, None)
        cv2.calcOpticalFlowPyrLK(there, pair.left, moved, None)


def test_time_of_a_full_frame(
    camera: CameraCalibration, config: VisionConfig, shipped_pair: StereoPair
) -> None:
    timed(
        lambda: look.observe(shipped_pair, camera, config.markers),
        lambda: opencv_markers(shipped_pair, config),
        FULL,
    )


def test_time_of_a_tracked_frame(
    camera: CameraCalibration, config: VisionConfig, shipped_pair: StereoPair
) -> None:
    before = look.observe(shipped_pair, camera, config.markers)
    timed(
        lambda: look.observe(shipped_pair, camera, config.markers, before),
        lambda: opencv_markers(shipped_pair, config),
        TRACKED,
    )


def test_time_of_an_odometry_frame(
    camera: CameraCalibration, config: VisionConfig, shipped_pair: StereoPair
) -> None:
    odometry = StereoOdometry(camera, config.odometry, config.markers.tool)
    odometry.process(shipped_pair, look.observe(shipped_pair, camera, config.markers).X_CM)
    timed(lambda: odometry.process(shipped_pair), lambda: opencv_odometry(shipped_pair), ODOMETRY)


KNOWN, ANY = 3.0, 16.0  # times OpenCV's detector


def test_time_and_count_of_markers_in_photographs() -> None:
    """Processor time a picture, in turn with OpenCV's detector and AprilTag's library."""
    try:
        files = sorted((recorded_sets.data_directory() / "photographs").glob("*.jpg"))
    except RequestRefused as absent:
        pytest.skip(str(absent))
    apriltag = pytest.importorskip("pupil_apriltags").Detector(families="tag36h11", nthreads=1)
    family = "DICT_APRILTAG_36h11"
    opencv = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    for file in files:
        picture = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        assert picture is not None
        every = picture_markers.search(picture, family).markers
        numbers = frozenset(marker.number for marker in every)
        ours, theirs = len(every), len(opencv.detectMarkers(picture)[0])
        work = (
            lambda picture=picture: opencv.detectMarkers(picture),
            lambda picture=picture: apriltag.detect(picture),
            lambda picture=picture, numbers=numbers: picture_markers.search(picture, family, numbers),
            lambda picture=picture: picture_markers.search(picture, family),
        )
        plain, tags, known, everything = (1e3 * spent_s for spent_s in least_in_turn(*work, rounds=5))
        print(
            f"\n{file.name}: OpenCV {plain:.1f} ms ({theirs}), AprilTag {tags:.1f} ms "
            f"({len(apriltag.detect(picture))}); known {known:.1f} ms, {known / plain:.2f} of {KNOWN:g}; "
            f"any {everything:.1f} ms ({ours}), {everything / plain:.2f} of {ANY:g}"
        )
        assert ours > theirs
        assert known < KNOWN * plain
        assert everything < ANY * plain
