"""A layout that was typed wrong: the marker that the others contradict is named, with size and direction."""

import numpy as np
import pytest

from tests.vision_pc.perception.test_markers import object_markers, observed, tool_marker
from tests.vision_pc.rendering import facing
from vision_pc.config.vision import MarkerSettings, VisionConfig
from vision_pc.core.perception.layout_check import misplaced_in_most, misplaced_marker
from vision_pc.core.types import CameraCalibration, FrameObservation, MisplacedMarker

SCENE = tool_marker(facing(0.1, 0.0, 0.5, (10, 15, 0))), facing(-0.3, 0.05, 1.1, (5, -12, 3))


def typed(settings: MarkerSettings, number: int, **places: float) -> MarkerSettings:
    """``settings`` with ``places`` of a marker of the object typed so."""
    layout = tuple(one.model_copy(update=places) if one.id == number else one for one in settings.object)
    return settings.model_copy(update={"object": layout})


def seen(
    camera: CameraCalibration, settings: MarkerSettings, only: tuple[int, ...] = (1, 2, 3)
) -> FrameObservation:
    scene = (SCENE[0], *object_markers(SCENE[1], only))
    return observed(camera, settings, scene, np.random.default_rng(5))


@pytest.mark.parametrize("residual_limit_px", [0.5, 2.0])  # the stranger left out of the pose, or in it
@pytest.mark.parametrize(
    ("number", "places", "off_mm"),
    [
        (2, {"x_m": 0.21}, (-10.0, 0.0)),
        (1, {"y_m": 0.01}, (0.0, -10.0)),
        (3, {"y_m": 0.185}, (0.0, 15.0)),
    ],
)
def test_a_place_typed_wrong_is_questioned_with_its_marker_and_direction(
    camera: CameraCalibration, config: VisionConfig, residual_limit_px: float, number: int,
    places: dict[str, float], off_mm: tuple[float, float],
) -> None:  # fmt: skip
    settings = config.markers.model_copy(update={"residual_limit_px": residual_limit_px})
    found = seen(camera, typed(settings, number, **places)).misplaced
    assert found.marker_id == number
    assert 1e3 * found.off_m == pytest.approx(off_mm, abs=1.5)
    assert f"marker {number} is seen" in str(found)


def test_a_layout_that_is_right_or_off_by_what_hanging_explains_is_not_questioned(
    camera: CameraCalibration, config: VisionConfig
) -> None:
    assert seen(camera, config.markers).misplaced is None
    assert seen(camera, typed(config.markers, 2, x_m=0.202)).misplaced is None


def test_two_markers_or_three_in_a_line_cannot_say_which_is_wrong(
    camera: CameraCalibration, config: VisionConfig
) -> None:
    wrong = typed(config.markers, 2, x_m=0.21)
    assert seen(camera, wrong, (1, 2)).misplaced is None
    markers = seen(camera, config.markers).markers
    line = typed(config.markers, 3, y_m=0.001)
    assert misplaced_marker(markers, float(camera.left.K[0, 0]), line) is None


def test_a_look_questions_what_most_of_its_frames_question(
    camera: CameraCalibration, config: VisionConfig
) -> None:
    wrong = seen(camera, typed(config.markers, 2, x_m=0.21))
    right = wrong._replace(misplaced=None)
    other = wrong._replace(misplaced=MisplacedMarker(1, np.ones(2), np.ones(2)))
    doubted = misplaced_in_most([wrong, wrong, wrong, right, other])
    assert doubted.marker_id == 2
    assert doubted.off_m == pytest.approx(wrong.misplaced.off_m)
    assert misplaced_in_most([wrong, wrong, right, right, other]) is None
    assert misplaced_in_most([right]) is None
