"""Looks: robust means with honest deviations, failures counted and told, regions tracked without a
difference.
"""

from collections.abc import Callable

import numpy as np
import pytest

from protocol.errors import MeasurementFailed
from tests.vision_pc.perception.test_markers import object_markers, tool_marker
from tests.vision_pc.rendering import facing, render
from vision_pc.config.vision import LookSettings, VisionConfig
from vision_pc.core import se3
from vision_pc.core.perception import look, markers
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, FrameObservation, StereoOffset

X_CM = facing(0.2, 0.05, 0.42, (2, 3, -4))
X_CO = facing(-0.25, 0.05, 1.1, (5, -8, 3))
X_BT = se3.transform(np.eye(3), (3.9, 0.0, 1.0))
NOISE = np.diag([1e-5, 1e-5, 4e-5, 2e-4, 2e-4, 1e-4]) ** 2
BIAS = np.diag([0.0, 0.0, 5e-4, 0.0, 0.0, 0.0]) ** 2
SETTINGS = LookSettings(frames=10, minimum_frames=3, huber_sigmas=2.0, offset_limit_px=8.0, std_factor=1.0)

Change = Callable[[int, Array], Array | None]


def frames(
    count: int, seed: int = 1, tool: Change | None = None, target: Change | None = None
) -> list[FrameObservation]:
    """Observations of X_CM and X_CO with NOISE; ``tool`` and ``target`` change or withhold a frame's pose."""
    generator = np.random.default_rng(seed)
    observations = []
    for k in range(count):
        measured = [se3.retract(X, np.sqrt(NOISE) @ generator.standard_normal(6)) for X in (X_CM, X_CO)]
        tool_pose, object_pose = (
            X if change is None else change(k, X) for change, X in zip((tool, target), measured, strict=True)
        )
        observations.append(
            FrameObservation(
                capture_ns=100 * k,
                frame_id=k,
                X_CM=tool_pose,
                cov_CM=None if tool_pose is None else NOISE + BIAS,
                bias_CM=None if tool_pose is None else BIAS,
                X_CO=object_pose,
                cov_CO=None if object_pose is None else NOISE + BIAS,
                bias_CO=None if object_pose is None else BIAS,
                markers=(),
                rejected={},
                offset=StereoOffset(0.0, 0.0, 0.1, 0.1),
            )
        )
    return observations


def test_mean_is_better_than_a_frame_and_keeps_the_bias() -> None:
    taken = look.combine(frames(25), X_BT, 42, SETTINGS)
    assert (taken.time_ns, taken.frames, taken.failed_tool, taken.failed_object) == (42, 25, 0, 0)
    np.testing.assert_array_equal(taken.X_BT, X_BT)
    np.testing.assert_allclose(np.diag(taken.cov_CM), np.diag(NOISE / 25 + BIAS), rtol=0.3)
    np.testing.assert_allclose(np.diag(taken.frame_cov_CM), np.diag(NOISE), rtol=0.6)
    np.testing.assert_allclose(taken.std_tool_m, np.sqrt(np.diag(taken.cov_CM))[:3])
    np.testing.assert_allclose(taken.std_object_rad, np.sqrt(np.diag(taken.cov_CO))[3:])


def test_a_look_is_known_as_much_wider_as_the_settings_say() -> None:
    wider = SETTINGS.model_copy(update={"std_factor": 1.5})
    plain, wide = (look.combine(frames(5), X_BT, 0, settings) for settings in (SETTINGS, wider))
    np.testing.assert_allclose(wide.std_object_m, 1.5 * plain.std_object_m)
    np.testing.assert_allclose(wide.std_tool_rad, 1.5 * plain.std_tool_rad)
    np.testing.assert_array_equal(wide.X_CO, plain.X_CO)


def test_normalised_errors_of_means_are_honest() -> None:
    squares = []
    for seed in range(60):
        taken = look.combine(frames(8, seed), X_BT, 0, SETTINGS)
        error = se3.local(X_CO, taken.X_CO)
        squares.append(error @ np.linalg.solve(taken.cov_CO - BIAS, error))
    assert 4.5 < np.mean(squares) < 7.5


def test_wild_frames_hardly_move_the_mean() -> None:
    def wild(k: int, X: Array) -> Array:
        return se3.retract(X, [0.05, -0.08, 0.2, 0.3, -0.2, 0.1]) if k in (2, 7) else X

    taken = look.combine(frames(10, tool=wild), X_BT, 0, SETTINGS)
    error = se3.local(X_CM, taken.X_CM)
    assert np.abs(error[:3]).max() < 5e-5
    assert np.abs(error[3:]).max() < 4e-4


def test_more_scatter_than_claimed_widens_the_deviation() -> None:
    generator = np.random.default_rng(3)

    def shaky(_: int, X: Array) -> Array:
        return se3.retract(X, 5.0 * np.sqrt(NOISE) @ generator.standard_normal(6))

    calm, shaken = (look.combine(frames(20, tool=t), X_BT, 0, SETTINGS) for t in (None, shaky))
    assert (np.diag(shaken.frame_cov_CM)[:3] > 9.0 * np.diag(calm.frame_cov_CM)[:3]).all()


def test_failed_frames_are_counted() -> None:
    taken = look.combine(
        frames(10, tool=lambda k, X: None if k < 4 else X, target=lambda k, X: None if k == 9 else X),
        X_BT,
        0,
        SETTINGS,
    )
    assert (taken.frames, taken.failed_tool, taken.failed_object) == (10, 4, 1)


@pytest.mark.parametrize(
    ("tool_frames", "object_frames", "cause"),
    [(2, 10, "measurement.tool_not_seen"), (10, 0, "measurement.object_not_seen")],
)
def test_too_few_frames_are_a_failure_never_a_number(
    tool_frames: int, object_frames: int, cause: str
) -> None:
    shown = frames(
        10,
        tool=lambda k, X: X if k < tool_frames else None,
        target=lambda k, X: X if k < object_frames else None,
    )
    with pytest.raises(MeasurementFailed, match=r"seen in \d+ of 10 frames, at least 3 are wanted") as failed:
        look.combine(shown, X_BT, 0, SETTINGS)
    assert failed.value.cause == cause


def test_no_frames_are_a_failure() -> None:
    with pytest.raises(MeasurementFailed) as failed:
        look.combine([], X_BT, 0, SETTINGS)
    assert failed.value.cause == "measurement.no_frames"


def test_one_frame_asked_for_is_one_frame_enough() -> None:
    taken = look.combine(frames(1), X_BT, 0, SETTINGS)
    np.testing.assert_allclose(taken.cov_CM, NOISE + BIAS, rtol=1e-9, atol=1e-18)


def test_tracked_region_changes_nothing_but_the_work(
    camera: CameraCalibration, config: VisionConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    regions = []
    detect = markers.detect

    def spied(*arguments: object) -> object:
        regions.append(arguments[2] if len(arguments) > 2 else None)
        return detect(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(markers, "detect", spied)
    scene = (*object_markers(X_CO), tool_marker(X_CM))
    pair = render(camera, scene, np.random.default_rng(1), frame_id=3)
    first = look.observe(pair, camera, config.markers)
    again = look.observe(pair, camera, config.markers, first._replace(offset=None))
    assert regions[0] is None
    assert regions[1] is not None
    assert len(regions) == 2
    for X, Y in ((first.X_CM, again.X_CM), (first.X_CO, again.X_CO)):
        assert X is not None
        assert Y is not None
        np.testing.assert_allclose(X, Y, atol=1e-5)


def test_marker_that_jumped_out_of_its_region_is_found(
    camera: CameraCalibration, config: VisionConfig
) -> None:
    generator = np.random.default_rng(1)
    first = look.observe(render(camera, (tool_marker(X_CM),), generator, frame_id=1), camera, config.markers)
    far = facing(-0.3, -0.1, 0.5)
    scene = (tool_marker(far), *object_markers(facing(0.3, 0.1, 1.2)))
    then = look.observe(render(camera, scene, generator, frame_id=2), camera, config.markers, first)
    assert np.abs(se3.local(far, then.X_CM)[:3]).max() < 1e-3
    assert then.X_CO is not None


def test_a_marker_that_was_refused_is_looked_for_again_at_once(
    camera: CameraCalibration, config: VisionConfig, generator: np.random.Generator
) -> None:
    """The first frame knows nothing of the right eye's offset: refused there, lost for the whole look."""
    tool, target = tool_marker(facing(0.1, 0.0, 0.5, (10, 15, 0))), object_markers(facing(-0.4, 0.0, 1.0))
    odd = render(camera, (*target, tool._replace(size=0.11)), generator, frame_id=1)
    seen = look.observe(odd, camera, config.markers)
    assert seen.rejected == {"wrong_size": 1}
    true = render(camera, (*target, tool), generator, frame_id=2)
    seen = look.observe(true, camera, config.markers, seen)
    assert seen.X_CM is not None
    assert seen.rejected == {}


def test_a_marker_that_comes_into_view_is_found_although_frames_are_skipped(
    camera: CameraCalibration, config: VisionConfig, generator: np.random.Generator
) -> None:
    """A detector that takes every second frame never meets a frame number that is a multiple of ten."""
    alone = render(camera, (tool_marker(X_CM),), generator)
    both = render(camera, (*object_markers(X_CO), tool_marker(X_CM)), generator)
    seen = look.observe(alone._replace(frame_id=1), camera, config.markers)
    assert seen.X_CM is not None
    assert seen.X_CO is None
    for frame_id in range(3, 23, 2):
        seen = look.observe(both._replace(frame_id=frame_id), camera, config.markers, seen)
    assert seen.X_CO is not None
    assert len(seen.markers) == 4
