"""Looking and moving on the whole emulator: oil, play and booms below, the eye model above."""

import copy
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from laboratory.experiments.positioning.corrected_run import operate, true_error_mm
from protocol.errors import MeasurementFailed
from protocol.faults import GroupState
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.simulated_measurements import load_eye_model, simulated_sight
from testbed.scenarios.scenario import chosen_overrides, load_settings
from tests.support.paths import CONFIGS
from vision_pc.core.types import CameraFrame, FrameObservation

pytestmark = pytest.mark.slow("whole worlds in lockstep")

SEED = 3
Observe = Callable[[CameraFrame, FrameObservation | None], FrameObservation]


@pytest.fixture(scope="module")
def calibrated() -> LockstepRig:
    settings = load_settings(CONFIGS, chosen_overrides(CONFIGS, "standard", SEED, []))
    sight = partial(simulated_sight, model=load_eye_model(CONFIGS), seed=SEED)
    rig = LockstepRig(settings, SEED, RunLog(), sight)
    rig.command("enable")
    operate(rig, "look", {"frames": 3})
    operate(rig, "local-track", {})
    return rig


@pytest.mark.timeout(600)
@pytest.mark.parametrize("trouble", ["view_lost", "camera_frozen"])
def test_without_fresh_sight_it_stops_on_its_way(calibrated: LockstepRig, trouble: str) -> None:
    rig = copy.deepcopy(calibrated)
    sensor = rig.eyes._sensor
    measured: Observe = sensor.observe
    seen: list[FrameObservation] = []

    def troubled(frame: CameraFrame, previous: FrameObservation | None) -> FrameObservation:
        seen.append(measured(frame, previous))
        if len(seen) < 30:
            return seen[-1]
        if trouble == "camera_frozen":
            return seen[29]._replace(capture_ns=frame.capture_ns, frame_id=frame.frame_id)
        return seen[-1]._replace(X_CO=None, cov_CO=None, bias_CO=None)

    sensor.observe = troubled  # type: ignore[method-assign]
    with pytest.raises(MeasurementFailed) as failed:
        operate(rig, "looking-and-moving", {})
    assert failed.value.cause == f"measurement.{trouble}"
    for _ in range(1200):  # 6 s: booms and slew ring on
        rig.world.clock.advance()
    assert rig.link.state.group_state is GroupState.STANDBY
    stood = rig.world.plant.truth().X_WT[:3, 3]
    for _ in range(100):
        rig.world.clock.advance()
    assert np.linalg.norm(rig.world.plant.truth().X_WT[:3, 3] - stood) < 1e-3
    assert np.linalg.norm(true_error_mm(rig)) > 50.0, "it must have stopped short of the object"
