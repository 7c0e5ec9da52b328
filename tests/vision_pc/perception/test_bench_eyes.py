"""What the eyes cost and how well they see, beside OpenCV's own corner refinement; `make bench` prints the
figures.
"""

import time
from collections.abc import Callable, Iterator

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from laboratory.experiments.hand_eye import real_sets
from protocol.errors import RequestRefused
from tests.vision_pc.perception.test_markers import Corners, measured_corners, object_markers, tool_marker
from tests.vision_pc.perception.test_watch import World
from tests.vision_pc.rendering import facing, render
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.perception import intrinsics, look, marker_edges, markers
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, StereoPair

pytestmark = [pytest.mark.bench, pytest.mark.benchmark(timer=time.process_time), pytest.mark.timeout(600)]


@pytest.fixture(autouse=True)
def one_core() -> Iterator[None]:
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield
    cv2.setNumThreads(before)


FULL, TRACKED, ODOMETRY = 1.0, 0.5, 0.5  # times OpenCV's own

_POSES = 300  # of one marker: enough for a share of flips of 1 %


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize(("size", "z"), [(0.10, 0.5), (0.15, 1.0), (0.12, 1.1), (0.10, 2.0)])
def test_corner_accuracy(
    camera: CameraCalibration, generator: np.random.Generator, size: float, z: float
) -> None:
    corners: Corners = measured_corners(camera.left, size, z, 60, generator)
    ours, peer = rms(corners.edges), rms(corners.opencv)
    print(
        f"\ncorners {1e3 * size:.0f} mm at {z:g} m: edge lines {ours:.4f} px rms,"
        f" bias {corners.outward.mean():+.4f} px; cv2 SUBPIX {peer:.4f} px rms"
    )
    assert ours < 0.06
    assert abs(corners.outward.mean()) < 0.02
    assert ours < peer


@pytest.mark.parametrize(("size", "z", "limit_mm"), [(0.15, 1.0, (0.2, 0.6)), (0.10, 2.0, (1.2, 4.0))])
def test_pose_accuracy_of_one_marker(
    camera: CameraCalibration,
    config: VisionConfig,
    generator: np.random.Generator,
    size: float,
    z: float,
    limit_mm: tuple[float, float],
) -> None:
    settings = config.markers.model_copy(
        update={"tool": config.markers.tool.model_copy(update={"size_m": size})}
    )
    errors, flips, missed = [], 0, 0
    for _ in range(_POSES):
        x, y = generator.uniform(-0.3, 0.3, 2) * z
        X_CM = facing(x, y, z, tuple(generator.uniform(-35, 35, 3)))
        marker = tool_marker(X_CM)._replace(size=size)
        seen = look.observe(render(camera, (marker,), generator), camera, settings)
        if seen.X_CM is None:
            missed += 1
            continue
        errors.append(se3.local(X_CM, seen.X_CM))
        flips += int(np.degrees(np.linalg.norm(errors[-1][3:])) > 5.0)
    lateral, depth = 1e3 * rms(np.array(errors)[:, :2]), 1e3 * rms(np.array(errors)[:, 2])
    print(
        f"\none marker {1e3 * size:.0f} mm at {z:g} m, both eyes: {lateral:.3f} / {depth:.3f} mm rms,"
        f" rotation {np.degrees(rms(np.array(errors)[:, 3:])):.3f}°, {flips} flips, {missed} missed of"
        f" {_POSES}; limits {limit_mm[0]:g} / {limit_mm[1]:g} mm, 1 % flips"
    )
    assert lateral < limit_mm[0]
    assert depth < limit_mm[1]
    assert flips <= 0.01 * _POSES
    assert missed <= 0.03 * _POSES


def test_pose_accuracy_of_the_object(
    camera: CameraCalibration, config: VisionConfig, generator: np.random.Generator
) -> None:
    errors = []
    for _ in range(40):
        X_CO = facing(*(generator.uniform(-0.3, 0.3, 2) * 2.0), 2.0, tuple(generator.uniform(-25, 25, 3)))
        seen = look.observe(render(camera, object_markers(X_CO), generator), camera, config.markers)
        if seen.X_CO is not None and len(seen.markers) == 3:
            errors.append(se3.local(X_CO, seen.X_CO))
    found = np.array(errors)
    lateral, depth = 1e3 * rms(found[:, :2]), 1e3 * rms(found[:, 2])
    p95 = float(np.percentile(np.degrees(np.linalg.norm(found[:, 3:], axis=1)), 95))
    print(
        f"\nobject, twelve corners at 2 m: {lateral:.3f} / {depth:.3f} mm rms across / along,"
        f" rotation p95 {p95:.3f}°, {len(found)} of 40"
    )
    assert lateral < 0.3
    assert depth < 1.0
    assert p95 < 0.5
    assert len(found) >= 36


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
        file = real_sets.data_directory() / "moveit" / name
    except RequestRefused as absent:
        pytest.skip(str(absent))
    picture = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        pytest.skip(f"{name} is absent")
    board = tuple(config.markers.object[0].model_copy(update={"id": number}) for number in range(1, count))
    settings = config.markers.model_copy(update={"dictionary": dictionary, "object": board})
    found, refused = markers.detect(picture, settings)
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


def timed(
    benchmark: BenchmarkFixture, work: Callable[[], object], plainly: Callable[[], object], limit: float
) -> None:
    """``limit``: times what the same takes ``plainly`` with OpenCV; of both the least of thirty rounds."""
    work()
    benchmark.pedantic(work, rounds=30)
    assert benchmark.stats is not None
    least_ms, peer_ms = 1e3 * benchmark.stats.stats.min, 1e3 * min(spent_s(plainly) for _ in range(30))
    print(f"\n{least_ms:.1f} ms; plainly with OpenCV {peer_ms:.1f} ms: {least_ms / peer_ms:.2f} of {limit:g}")
    assert least_ms < limit * peer_ms


def spent_s(work: Callable[[], object]) -> float:
    """Processor time of one round."""
    began = time.process_time()
    work()
    return time.process_time() - began


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
    benchmark: BenchmarkFixture, camera: CameraCalibration, config: VisionConfig, shipped_pair: StereoPair
) -> None:
    timed(
        benchmark,
        lambda: look.observe(shipped_pair, camera, config.markers),
        lambda: opencv_markers(shipped_pair, config),
        FULL,
    )


def test_time_of_a_tracked_frame(
    benchmark: BenchmarkFixture, camera: CameraCalibration, config: VisionConfig, shipped_pair: StereoPair
) -> None:
    before = look.observe(shipped_pair, camera, config.markers)
    timed(
        benchmark,
        lambda: look.observe(shipped_pair, camera, config.markers, before),
        lambda: opencv_markers(shipped_pair, config),
        TRACKED,
    )


def test_time_of_an_odometry_frame(
    benchmark: BenchmarkFixture, camera: CameraCalibration, config: VisionConfig, shipped_pair: StereoPair
) -> None:
    odometry = StereoOdometry(camera, config.odometry, config.markers.tool)
    odometry.process(shipped_pair, look.observe(shipped_pair, camera, config.markers).X_CM)
    timed(benchmark, lambda: odometry.process(shipped_pair), lambda: opencv_odometry(shipped_pair), ODOMETRY)
