"""What is predicted of a motion that nothing corrects, where joints have backlash."""

import numpy as np
import pytest

from tests.vision_pc.program_settings import BOOM, shipped
from tests.vision_pc.synthetic import SyntheticRig, draw, silent
from vision_pc.config.programs import LocalErrorModelSettings
from vision_pc.core.calibration.boom_levers import slew_lever
from vision_pc.core.calibration.local_error_model import (
    LocalTrack,
    fit_error_model,
    record_local_track,
    solve_step,
)
from vision_pc.core.calibration.orientation import adjust_orientation
from vision_pc.core.positioning.predicted_end import PlannedStep, predicted_end
from vision_pc.core.se3 import Array
from vision_pc.core.types import StereoOffset

PROGRAMS = shipped()


def adapting(**changes: float) -> LocalErrorModelSettings:
    return PROGRAMS.local_map.model_copy(update=changes)


class PlayingRig(SyntheticRig):
    """Lift and tilt have play before their encoders, half as wide as is drawn for real machines."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        super().__init__(draw(rng, servo_std=5e-5, odometry_scale=1.0), seed)
        self.half_booms = rng.uniform(3e-5, 3e-4, 2)

    def advance(self, q: Array) -> None:
        self.booms_play = np.clip(self.booms_play - (q - self.q)[1:3], -self.half_booms, self.half_booms)
        super().advance(q)


async def calibrated(seed: int) -> tuple[PlayingRig, LocalTrack]:
    arm = PlayingRig(seed)
    await adjust_orientation(arm, arm, silent, PROGRAMS.orientation)
    return arm, await record_local_track(arm, arm, silent, adapting(), BOOM)


async def test_the_slews_backlash_is_predicted_of_one_motion_and_not_of_corrected_ones() -> None:
    """The slew's other side along its lever, at the end and in the legs; what else such ends differ by."""
    arm, track = await calibrated(10)
    look = await arm.look()
    fitted = fit_error_model(track, look.X_CM[:3, 3], BOOM, adapting(strain_std=1e-3))
    assert 0.4 < fitted.slew_play / arm.truth.play < 1.3  # the legs' other errors are in it

    def predicted(way_m: float, corrections: int, else_m: float = 0.0) -> Array:
        settings = PROGRAMS.positioning.model_copy(update={"corrections": corrections})
        x, covariance = solve_step(fitted, np.array([way_m, 0.0, 0.0]))
        step, local_map = PlannedStep(x, covariance, 1.0, 1), adapting(leg_end_std_m=else_m)
        camera = predicted_end(look, fitted, track, step, settings, local_map).covariance
        return fitted.R @ camera @ fitted.R.T

    assert np.array_equal(predicted(0.8, 4, 2e-3), predicted(0.8, 4))
    lever = slew_lever(fitted.X_BT)
    along = lever / np.linalg.norm(lever)
    across = np.array([-along[1], along[0], 0.0])
    x = solve_step(fitted, np.array([0.8, 0.0, 0.0]))[0]
    in_legs = float(x @ x) / (2.0 * PROGRAMS.local_map.leg_m**2)
    alone = predicted(0.8, 0)
    side = along @ alone @ along - across @ alone @ across
    whole = (2.0 * fitted.slew_play * np.linalg.norm(lever)) ** 2
    assert side == pytest.approx(0.5 * (1.0 + in_legs) * whole, rel=0.1)
    other = predicted(0.8, 0, 2e-3) - alone
    assert across @ other @ across == pytest.approx(in_legs * 2e-3**2, rel=0.05)


async def test_lengths_by_an_offset_that_nothing_tells_are_as_unsure_as_the_look_s_distance() -> None:
    """A hole 6 mm off was told as inside, P 0.89: its distance was known to 3 %, odometry to 0.1 %."""
    arm, track = await calibrated(10)
    look = await arm.look()
    fitted = fit_error_model(track, look.X_CM[:3, 3], BOOM, adapting())
    x, covariance = solve_step(fitted, np.array([0.4, 0.0, 0.0]))
    cov_CO = look.cov_CO.copy()
    cov_CO[2, 2] = (0.03 * look.X_CO[2, 3]) ** 2

    def told(std_px: float) -> Array:
        seen = look._replace(cov_CO=cov_CO, offset=StereoOffset(0.0, 0.0, std_px, 0.01))
        expected = PlannedStep(x, covariance, 0.9, 4)
        return predicted_end(seen, fitted, track, expected, PROGRAMS.positioning, adapting()).covariance

    assert np.array_equal(told(0.05), told(0.15))
    wider = told(3.5) - told(0.05)
    np.testing.assert_allclose(wider, (0.03 * np.linalg.norm(x)) ** 2 * np.eye(3), atol=1e-7)
