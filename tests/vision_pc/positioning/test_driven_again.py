"""What odometry sees outside half of the tolerance is driven again, beyond the corrections asked for."""

import numpy as np
import pytest

from tests.vision_pc.program_settings import BOOM, shipped
from tests.vision_pc.synthetic import SyntheticRig, draw, silent
from vision_pc.config.programs import LocalErrorModelSettings
from vision_pc.core.calibration.local_error_model import record_local_track
from vision_pc.core.positioning.corrected_positioning import _needs_another_motion

PROGRAMS = shipped()
MAP, POSITIONING = PROGRAMS.local_map, PROGRAMS.positioning


def settings(servo_std_m: float = 3e-4) -> LocalErrorModelSettings:
    return MAP.model_copy(update={"servo_std_m": servo_std_m})


@pytest.mark.parametrize(
    ("off_mm", "corrections", "drives"), [(2.4, 5, 6), (2.6, 5, 10), (6.5, 0, 1)], ids=str
)
async def test_what_odometry_sees_far_off_is_driven_again_unless_one_shot_was_asked_for(
    off_mm: float, corrections: int, drives: int
) -> None:
    arm = SyntheticRig(draw(np.random.default_rng(10), servo_std=2e-5), 10)
    track = await record_local_track(arm, arm, silent, settings(), BOOM)
    asked = POSITIONING.model_copy(update={"corrections": corrections})
    residuals, parts = [np.array([0.5, 0.0, 0.5])], 2 if corrections else 1
    while _needs_another_motion(residuals, parts, track, asked, settings()):
        residuals.append(np.array([1e-3 * off_mm, 0.0, 0.0]))
    assert len(residuals) - 1 == drives
