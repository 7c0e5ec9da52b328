"""The right eye's offset as real cameras have it: pixels off, and never believed beyond reason."""

import numpy as np
import pytest

from protocol.errors import MeasurementFailed
from tests.vision_pc.perception import test_look
from tests.vision_pc.perception.test_markers import object_markers, observed, tool_marker
from tests.vision_pc.rendering import facing
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics, look
from vision_pc.core.types import CameraCalibration, StereoOffset


@pytest.mark.parametrize(("x_px", "y_px"), [(3.5, 1.0), (-3.5, -1.0)])
def test_a_calibration_off_by_pixels_is_corrected(
    camera: CameraCalibration, config: VisionConfig, generator: np.random.Generator, x_px: float, y_px: float
) -> None:
    truly = intrinsics.with_offset(camera, x_px, y_px)
    wide = config.markers.model_copy(update={"offset_std_px": 3.5})
    X_CM, X_CO = facing(0.2, 0.05, 0.42), facing(-0.25, 0.05, 1.1, (5, -8, 3))
    seen = None
    for _ in range(4):
        seen = observed(camera, wide, (*object_markers(X_CO), tool_marker(X_CM)), generator, seen, truly)
    assert abs(seen.offset.x_px - x_px) < 3.0 * seen.offset.std_x_px < 0.4
    assert abs(seen.offset.y_px - y_px) < 3.0 * seen.offset.std_y_px < 0.4
    assert np.abs(se3.local(X_CO, seen.X_CO)[:2]).max() < 0.5e-3
    assert abs(se3.local(X_CO, seen.X_CO)[2]) < 3.0 * np.sqrt(seen.cov_CO[2, 2])
    assert np.abs(se3.local(X_CM, seen.X_CM)[:3]).max() < 0.5e-3


def test_an_offset_beyond_reason_is_refused_by_name() -> None:
    wild = [one._replace(offset=StereoOffset(-9.1, 0.0, 0.1, 0.1)) for one in test_look.frames(5)]
    with pytest.raises(MeasurementFailed, match=r"9\.10 px across") as refused:
        look.combine(wild, test_look.X_BT, 0, test_look.SETTINGS)
    assert refused.value.cause == "measurement.camera_off_calibration"
