"""The right eye's offset as real cameras have it: pixels off, drifting, and never believed beyond reason."""

import numpy as np
import pytest

from protocol.errors import MeasurementFailed
from tests.vision_pc.perception import test_look
from tests.vision_pc.perception.test_markers import object_markers, observed, tool_marker
from tests.vision_pc.rendering import facing
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics, look
from vision_pc.core.types import CameraCalibration, FrameObservation, StereoOffset

MINUTE_NS = 60_000_000_000


@pytest.mark.parametrize(("x_px", "y_px"), [(3.5, 1.0), (-3.5, -1.0)])
def test_a_calibration_off_by_pixels_is_corrected(
    camera: CameraCalibration, config: VisionConfig, generator: np.random.Generator, x_px: float, y_px: float
) -> None:
    truly = intrinsics.with_offset(camera, x_px, y_px)
    wide = config.markers.model_copy(update={"offset_std_px": 3.5, "shared_prints": True})
    X_CM, X_CO = facing(0.2, 0.05, 0.42), facing(-0.25, 0.05, 1.1, (5, -8, 3))
    seen = None
    for _ in range(4):
        seen = observed(camera, wide, (*object_markers(X_CO), tool_marker(X_CM)), generator, seen, truly)
    assert seen is not None
    assert seen.offset is not None
    assert seen.X_CO is not None
    assert seen.X_CM is not None
    assert seen.cov_CO is not None
    assert abs(seen.offset.x_px - x_px) < 3.0 * seen.offset.std_x_px < 0.4
    assert abs(seen.offset.y_px - y_px) < 3.0 * seen.offset.std_y_px < 0.4
    assert np.abs(se3.local(X_CO, seen.X_CO)[:2]).max() < 0.5e-3
    assert abs(se3.local(X_CO, seen.X_CO)[2]) < 3.0 * np.sqrt(seen.cov_CO[2, 2])
    assert np.abs(se3.local(X_CM, seen.X_CM)[:3]).max() < 0.5e-3


@pytest.mark.slow("many pictures are drawn")
def test_frames_of_the_same_prints_do_not_make_the_offset_certain(
    camera: CameraCalibration, config: VisionConfig, generator: np.random.Generator
) -> None:
    """A tool print that is 0.3 % too large, 1.5 σ of what is allowed here: more frames do not mend it."""
    shared = config.markers.model_copy(
        update={"shared_prints": True, "print_size_std": 0.002, "offset_std_px": 3.5, "offset_floor_px": 1e-3}
    )
    X_CM = facing(0.2, 0.05, 0.42)
    grown = tool_marker(X_CM)._replace(size=0.1003)
    found: dict[bool, FrameObservation | None] = {True: None, False: None}
    for _ in range(8):
        for honest, settings in ((True, shared), (False, shared.model_copy(update={"shared_prints": False}))):
            found[honest] = observed(camera, settings, (grown,), generator, found[honest], camera)
    honest, proud = found[True], found[False]
    assert honest is not None
    assert honest.offset is not None
    assert proud is not None
    assert proud.offset is not None
    assert abs(honest.offset.x_px) < 3.0 * honest.offset.std_x_px
    assert proud.offset.std_x_px < 0.6 * honest.offset.std_x_px


def test_between_looks_the_offset_is_known_less_well_again(config: VisionConfig) -> None:
    known = test_look.frames(1)[0]._replace(capture_ns=0, offset=StereoOffset(1.2, 0.3, 0.03, 0.03))
    drifting = config.markers.model_copy(update={"offset_drift_px": 0.1})
    after = [look.priors_after(known, drifting, k * MINUTE_NS).offset for k in (0, 4, 10**9)]
    assert [offset.x_px for offset in after] == [1.2] * 3
    assert after[0].std_x_px == 0.03
    assert after[1].std_x_px == pytest.approx(np.hypot(0.03, 0.2))
    assert after[2].std_x_px == config.markers.offset_std_px  # no less certain than at first
    assert look.priors_after(known, config.markers, 4 * MINUTE_NS).offset == known.offset


def test_an_offset_beyond_reason_is_refused_by_name() -> None:
    wild = [one._replace(offset=StereoOffset(-9.1, 0.0, 0.1, 0.1)) for one in test_look.frames(5)]
    with pytest.raises(MeasurementFailed, match=r"9\.10 px across") as refused:
        look.combine(wild, test_look.X_BT, 0, test_look.SETTINGS)
    assert refused.value.cause == "measurement.camera_off_calibration"
