"""A tool whose marker cannot be read any more: known by its outline, to less than a tenth of a millimetre."""

from collections.abc import Callable, Sequence

import cv2
import numpy as np
import pytest

from plant_emulator.core.faults.kinds import CameraBlind, Fault, MarkerCovered
from protocol.errors import MeasurementFailed
from testbed.lockstep.clock import run
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.run_log import RunLog
from testbed.scenarios.settings import load_settings
from tests.support.paths import CONFIGS
from vision_pc.config.vision import MarkerSettings
from vision_pc.core.perception import intrinsics, look
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, FrameObservation, Image, StereoPair, ToolPieces

_COVERED = MarkerCovered(marker_id=0, share=1.0)
Change = Callable[[Image], Image]


class Pictures:
    """Of an arm at rest: some that show the marker, and some after a fault."""

    def __init__(self, fault: Fault, wall_seed: int = 1) -> None:
        settings = load_settings(CONFIGS, {"scene": {"wall": {"texture_seed": wall_seed}}})
        rig = LockstepRig(settings, 1, RunLog())
        rig.command("enable")
        self.camera: CameraCalibration = intrinsics.calibration(settings.vision.camera)
        self.settings: MarkerSettings = settings.vision.markers
        self.before: Sequence[StereoPair] = run(rig.camera.pairs_at_rest(5)).pairs
        rig.world.plant.inject(fault)
        self.after: Sequence[StereoPair] = run(rig.camera.pairs_at_rest(5)).pairs

    def seen(
        self, settings: MarkerSettings | None = None, left: Change | None = None, right: Change | None = None
    ) -> list[FrameObservation]:
        """Observations of all pictures, those after the fault changed by ``left`` and ``right``."""
        found: list[FrameObservation] = []
        later = [
            pair._replace(
                left=pair.left if left is None else left(pair.left),
                right=pair.right if right is None else right(pair.right),
            )
            for pair in self.after
        ]
        for pair in (*self.before, *later):
            previous = found[-1] if found else None
            found.append(look.observe(pair, self.camera, settings or self.settings, previous))
        return found


@pytest.fixture(scope="module")
def covered() -> Pictures:
    return Pictures(_COVERED)


def shifted(x_px: float, y_px: float) -> Change:
    """The picture moved, the tool and all the rest."""
    M = np.array([[1.0, 0.0, x_px], [0.0, 1.0, y_px]])
    return lambda image: np.asarray(
        cv2.warpAffine(image, M, image.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE),
        dtype=np.uint8,
    )


def places(seen: Sequence[FrameObservation]) -> Array:
    found = [each.X_CM[:3, 3] for each in seen if each.X_CM is not None]
    assert len(found) == len(seen)
    return np.array(found)


def test_a_covered_marker_is_where_the_outline_says(covered: Pictures) -> None:
    seen = covered.seen()
    assert [each.by_outline for each in seen] == [False] * 5 + [True] * 5
    off = places(seen[5:]) - places(seen[:5]).mean(axis=0)
    assert np.abs(off[:, :2]).max() < 0.1e-3
    told = seen[-1]
    assert told.cov_CM is not None
    assert told.bias_CM is not None
    deviations = np.sqrt(np.diag(told.cov_CM)[:2])
    assert (np.abs(off[-1, :2]) < 3.0 * deviations).all()
    assert (deviations < 0.3e-3).all()
    assert all(marker.marker_id != 0 for marker in told.markers)  # it was not seen
    assert (np.diag(told.bias_CM)[:2] > np.diag(seen[4].bias_CM)[:2]).all()  # type: ignore[arg-type]


def test_a_look_tells_by_what_it_knew_the_tool(covered: Pictures) -> None:
    seen = covered.seen()
    settings = load_settings(CONFIGS, {}).vision.look
    found = look.combine(seen[5:], np.eye(4), 0, settings)
    assert (found.by_outline, found.failed_tool) == (5, 0)
    assert look.combine(seen[:5], np.eye(4), 0, settings).by_outline == 0


def test_a_tool_that_has_moved_a_little_is_followed(covered: Pictures) -> None:
    """Tool and pictures by 0.8 px: in space by as much as that is at its distance."""
    seen = covered.seen(left=shifted(0.8, -0.5), right=shifted(0.8, -0.5))
    assert all(each.by_outline for each in seen[5:])
    way = places(seen[5:]).mean(axis=0) - places(seen[:5]).mean(axis=0)
    metres = places(seen[:5]).mean(axis=0)[2] / covered.camera.left.K[0, 0]
    assert way[:2] == pytest.approx(metres * np.array([0.8, -0.5]), abs=0.15 * metres)


@pytest.mark.parametrize(("left", "right"), [((2.5, 0.0), (2.5, 0.0)), ((0.0, 0.0), (0.0, 2.5))])
def test_a_tool_that_was_moved_is_refused(
    covered: Pictures, left: tuple[float, float], right: tuple[float, float]
) -> None:
    """In one eye alone it is the camera that has changed: neither is believed."""
    seen = covered.seen(left=shifted(*left), right=shifted(*right))
    assert [each.missing_tool for each in seen[5:]] == ["moved"] * 5
    with pytest.raises(MeasurementFailed) as refused:
        look.combine(seen[5:], np.eye(4), 0, load_settings(CONFIGS, {}).vision.look)
    assert refused.value.cause == "measurement.tool_moved"


def test_without_an_outline_the_tool_is_not_seen(covered: Pictures) -> None:
    blank = covered.settings.tool.model_copy(update={"outline_m": ()})
    seen = covered.seen(covered.settings.model_copy(update={"tool": blank}))
    assert [each.missing_tool for each in seen[5:]] == ["not_seen"] * 5
    assert seen[-1].tool is None


def test_an_outline_that_tells_one_direction_is_not_learnt(covered: Pictures) -> None:
    """Two parallel sides say nothing of a shift along them."""
    bar = ((-0.025, -1.0, 0.025, 1.0),)
    tool = covered.settings.tool.model_copy(update={"outline_m": bar})
    seen = covered.seen(covered.settings.model_copy(update={"tool": tool}))
    assert seen[4].tool is None
    assert seen[-1].missing_tool == "not_seen"


def blank_from(share: float, pieces: ToolPieces) -> Change:
    """A picture that is even to the right of where ``share`` of the outline's pieces are."""
    column = int(np.quantile(pieces.middles[:, 0], share))

    def change(image: Image) -> Image:
        changed = image.copy()
        changed[:, column:] = 120
        return changed

    return change


@pytest.mark.parametrize(("share", "known"), [(0.8, True), (0.55, False), (0.45, False)])
def test_enough_of_the_outline_must_be_there(covered: Pictures, share: float, known: bool) -> None:
    taught = covered.seen()[4].tool
    assert taught is not None
    left, right = (blank_from(share, pieces) for pieces in taught.outlines)
    seen = covered.seen(left=left, right=right)[5:]
    assert [each.missing_tool for each in seen] == [None if known else "not_seen"] * 5


def test_what_is_no_outline_of_the_tool_is_not_believed(covered: Pictures) -> None:
    """A drawing of another tool: what is learnt along it belongs to the wall, and is gone before another."""
    wall = ((-0.16, -0.30, 0.20, 0.16),)
    tool = covered.settings.tool.model_copy(update={"outline_m": wall})
    other = Pictures(_COVERED, wall_seed=99)
    other.before = covered.before
    seen = other.seen(covered.settings.model_copy(update={"tool": tool}))
    assert seen[4].tool is not None
    assert [each.missing_tool for each in seen[5:]] == ["not_seen"] * 5


def test_nothing_is_known_where_nothing_is_seen() -> None:
    seen = Pictures(CameraBlind(grey=80)).seen()
    assert seen[4].tool is not None
    assert [each.missing_tool for each in seen[5:]] == ["not_seen"] * 5
