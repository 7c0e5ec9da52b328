"""What the tool still does after STOP, and with the valves shut, on the emulated plant in lockstep.

Prints its figures, which docs/console.md tells an operator: pytest tests/controller/test_after_stop.py -s
"""

from typing import NamedTuple

import numpy as np
import pytest

from controller.core.settings import ScanSettings
from foundation.configuration import load
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.plant import Plant
from protocol.faults import CommandCode, GroupState, Reason
from protocol.pose import Pose
from protocol.reference_messages import ReferencePose
from testbed.lockstep.clock import ClosedLoop
from tests.controller.conftest import CONFIGS

pytestmark = [pytest.mark.slow("many stops on the emulated plant"), pytest.mark.timeout(600)]

STEPS_M = ((0.3, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.3), (0.0, 0.0, -0.3))
SLOW_S, FAST_S = 12.0, 3.0  # for such a step


class AfterStop(NamedTuple):
    """mm from where the tool truly was when STOP was accepted, at a speed in mm/s: how far it went while its
    path ended, in so many s, then within 2 s, and what it still moves each second as it is held; mm/s that it
    sinks with the valves shut, from a second after Disable on.
    """

    speed: float
    path_s: float
    ramp: float
    later: float
    held: float
    sinks: float


def _tool_mm(loop: ClosedLoop) -> np.ndarray:
    return 1e3 * loop.plant.truth().X_BT[:3, 3]


def _stopped(
    settings: ScanSettings, payload_kg: float, step_m: tuple[float, float, float], step_s: float
) -> AfterStop:
    plant = load(PlantConfig, CONFIGS / "plant.yaml", {"payload": {"mass_kg": payload_kg}})
    loop = ClosedLoop(settings, Plant(plant, 1))
    loop.enable()
    loop.run(3.0)
    start = loop.view.X_BT_cmd
    goal = Pose(tuple(np.add(start.p_m, step_m).tolist()), start.q_wxyz)
    assert loop.refer(lambda i: ReferencePose(i, goal, step_s)) is Reason.ACCEPTED
    loop.run(0.5 * step_s)
    before = _tool_mm(loop)
    loop.step()
    speed = float(np.linalg.norm(_tool_mm(loop) - before)) / settings.cycle_s
    assert loop.command(CommandCode.STOP) is Reason.ACCEPTED
    began, path = _tool_mm(loop), 0
    while loop.view.group_state is not GroupState.STANDBY:
        loop.step()
        path += 1
        assert path * settings.cycle_s < 1.0
    ended = _tool_mm(loop)
    loop.run(2.0)
    rests = _tool_mm(loop)
    loop.run(5.0)
    held = _tool_mm(loop)
    assert loop.command(CommandCode.DISABLE) is Reason.ACCEPTED
    loop.run(1.0)
    shut = _tool_mm(loop)
    loop.run(10.0)
    sunk = _tool_mm(loop) - shut
    return AfterStop(
        speed,
        path * settings.cycle_s,
        float(np.linalg.norm(ended - began)),
        float(np.linalg.norm(rests - ended)),
        float(np.linalg.norm(held - rests)) / 5.0,
        -float(sunk[2]) / 10.0,
    )


@pytest.mark.parametrize("step_s", [SLOW_S, FAST_S])
@pytest.mark.parametrize("payload_kg", [0.0, 80.0])
def test_after_stop_the_tool_rolls_out_and_rests_and_sinks_slowly_with_the_valves_shut(
    settings: ScanSettings, payload_kg: float, step_s: float
) -> None:
    print(f"\n{payload_kg:g} kg: mm/s; s and mm until the path has ended, mm in 2 s after; mm/s held, sinks")
    seen = []
    for step in STEPS_M:
        seen.append(each := _stopped(settings, payload_kg, step, step_s))
        print(
            f"  {each.speed:.0f}; {each.path_s:.2f} s {each.ramp:.1f}, {each.later:.1f}; "
            f"{each.held:.2f}, {each.sinks:+.2f}"
        )
    for each in seen:
        assert 0.25 < each.path_s < 0.6
        assert each.ramp + each.later < (25.0 if step_s == SLOW_S else 110.0)
        assert each.held < 1.5
        assert (-0.4 if payload_kg == 0.0 else 0.4) < each.sinks < 1.3
