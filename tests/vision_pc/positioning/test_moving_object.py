"""An object that moves: seen over the legs or the path, or by a last look elsewhere than expected."""

import numpy as np
import pytest

from protocol.errors import MeasurementFailed
from tests.vision_pc.program_settings import BOOM, shipped
from tests.vision_pc.synthetic import SyntheticRig, draw, silent
from vision_pc.core.calibration.local_error_model import record_local_track
from vision_pc.core.calibration.object_motion import object_motion, refuse_moving_object
from vision_pc.core.calibration.orientation import adjust_orientation
from vision_pc.core.calibration.trajectory_matching import trajectory_matching
from vision_pc.core.positioning.corrected_positioning import CorrectedResult, look_then_move_corrected
from vision_pc.core.positioning.look_then_move import look_then_move
from vision_pc.core.se3 import Array, transform
from vision_pc.core.types import Look, WatchSample

PROGRAMS = shipped()
RNG_NOISE_M = 3e-4


class Shifted(SyntheticRig):
    """Its object is ``shift_m`` aside, in B, from the second look on: it went while the arm drove."""

    shift_m = 0.0
    looks = 0

    async def look(self, frames: int | None = None) -> Look:
        self.looks += 1
        if self.looks == 2:
            X_BO = self.truth.X_BO.copy()
            X_BO[1, 3] += self.shift_m
            self.truth = self.truth._replace(X_BO=X_BO)
        return await super().look()


async def driven(shift_m: float) -> tuple[Shifted, CorrectedResult]:
    rig = Shifted(draw(np.random.default_rng(4)), 4)
    await adjust_orientation(rig, rig, silent, PROGRAMS.orientation)
    track = await record_local_track(rig, rig, silent, PROGRAMS.local_map, BOOM)
    rig.shift_m, rig.looks = shift_m, 0
    made = PROGRAMS.positioning, PROGRAMS.local_map, BOOM
    return rig, await look_then_move_corrected(rig, rig, silent, *made, track)


@pytest.mark.parametrize("shift_m", [0.0, 0.004, 0.03])
async def test_a_last_look_that_contradicts_odometry_ends_so_and_widens_what_follows(shift_m: float) -> None:
    rig, result = await driven(shift_m)
    assert (result.positioning.ended == "contradicted") is (shift_m > 0.0)
    assert result.track.contradiction == pytest.approx(shift_m, abs=1.5e-3)
    again = await look_then_move_corrected(
        rig, rig, silent, PROGRAMS.positioning, PROGRAMS.local_map, BOOM, result.track
    )
    if shift_m == 0.03:  # it may go on: nothing is sure of the next end
        assert again.positioning.steps[0].expected.inside < 0.1
        assert again.positioning.ended != "contradicted"  # it has not
        assert again.track.contradiction == 0.0


@pytest.mark.parametrize("shift_m", [0.0, 0.03])
async def test_the_papers_form_ends_contradicted_where_the_object_went_while_the_arm_drove(
    shift_m: float,
) -> None:
    rig = Shifted(draw(np.random.default_rng(4)), 4)
    await adjust_orientation(rig, rig, silent, PROGRAMS.orientation)
    calibration = await trajectory_matching(rig, rig, silent, PROGRAMS.trajectory, PROGRAMS.local_map)
    rig.shift_m, rig.looks = shift_m, 0
    one = PROGRAMS.positioning.model_copy(update={"inputs": 1})
    result = await look_then_move(rig, rig, silent, one, calibration)
    assert (result.ended == "contradicted") is (shift_m > 0.0)


class Sliding(SyntheticRig):
    """Its object slides along y of B at ``speed_m_s`` with every picture."""

    speed_m_s = 0.0

    def advance(self, q: Array) -> None:
        X_BO = self.truth.X_BO.copy()
        X_BO[1, 3] += self.speed_m_s * self.period_s
        self.truth = self.truth._replace(X_BO=X_BO)
        super().advance(q)


@pytest.mark.parametrize("speed_mm_s", [0.0, 0.3, -2.0])
async def test_an_object_that_slides_while_the_path_is_driven_is_refused(speed_mm_s: float) -> None:
    rig = Sliding(draw(np.random.default_rng(6)), 6)
    await adjust_orientation(rig, rig, silent, PROGRAMS.orientation)
    rig.speed_m_s = 1e-3 * speed_mm_s
    if speed_mm_s == 0.0:
        await trajectory_matching(rig, rig, silent, PROGRAMS.trajectory, PROGRAMS.local_map)
        return
    with pytest.raises(MeasurementFailed, match="the object moves by") as refused:
        await trajectory_matching(rig, rig, silent, PROGRAMS.trajectory, PROGRAMS.local_map)
    assert refused.value.cause == "target.moves"


def samples(speed_m_s: float, noise_m: float = RNG_NOISE_M, count: int = 150) -> list[WatchSample]:
    """Ten pictures a second of a camera that goes aside by 0.3 m and back, and of an object that slides."""
    rng, made = np.random.default_rng(7), []
    for k in range(count):
        X = transform(np.eye(3), np.array([0.3 * np.sin(np.pi * k / (count - 1)), 0.0, 0.0]))
        p_C0O = np.array([0.1 + speed_m_s * 0.1 * k, 0.0, 1.0])
        X_CO = transform(np.eye(3), p_C0O - X[:3, 3] + rng.normal(0.0, noise_m, 3))
        made.append(WatchSample(k * 100_000_000, np.eye(4), X, None, X_CO))
    return made


@pytest.mark.parametrize("speed_mm_s", [0.0, 0.05, 0.2, -1.0])
def test_the_speed_of_an_object_is_found_over_the_legs(speed_mm_s: float) -> None:
    motion = object_motion(samples(1e-3 * speed_mm_s), 3e-4)
    assert motion is not None
    assert 1e3 * motion.shift[0] / motion.time_s == pytest.approx(speed_mm_s, abs=0.06)
    if abs(speed_mm_s) > 0.1:
        with pytest.raises(MeasurementFailed, match=r"moves by \d\.\d+ mm/s") as refused:
            refuse_moving_object(samples(1e-3 * speed_mm_s), 0.6, PROGRAMS.local_map)
        assert refused.value.cause == "target.moves"
    else:
        refuse_moving_object(samples(1e-3 * speed_mm_s), 0.6, PROGRAMS.local_map)


def test_what_is_known_to_creep_by_less_than_matters_is_not_refused() -> None:
    exact = PROGRAMS.local_map.model_copy(update={"odometry_std_m": 1e-6})
    refuse_moving_object(samples(5e-5, noise_m=1e-6), 0.0, exact)  # 0.7 mm in all


def test_what_was_seen_too_seldom_says_nothing() -> None:
    assert object_motion([s._replace(X_CO=None) for s in samples(1e-3)], 3e-4) is None
    refuse_moving_object(samples(1e-3, noise_m=0.02), 0.6, PROGRAMS.local_map)  # 15 mm in its own noise
