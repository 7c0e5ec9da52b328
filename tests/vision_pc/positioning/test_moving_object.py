"""An object that moves while the legs or the path are driven."""

import numpy as np
import pytest

from protocol.errors import MeasurementFailed
from tests.vision_pc.program_settings import shipped
from tests.vision_pc.synthetic import SyntheticRig, draw, silent
from vision_pc.core.calibration.object_motion import object_motion, refuse_moving_object
from vision_pc.core.calibration.orientation import adjust_orientation
from vision_pc.core.calibration.trajectory_matching import trajectory_matching
from vision_pc.core.se3 import Array, transform
from vision_pc.core.types import WatchSample

PROGRAMS = shipped()
RNG_NOISE_M = 3e-4


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
