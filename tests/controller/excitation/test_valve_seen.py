"""How far a spool hangs behind: what slow triangles tell, and quick ones on a load that swings do not."""

import numpy as np
import pytest

from controller.core.excitation.plan import Excitation, Phase, Stroke, StrokeKind, begun
from controller.core.excitation.valve_seen import with_slack
from tests.controller.excitation.toy_valve import START, plan_for

JOINT = 5
LIMITS = plan_for(JOINT).limits
TOP_SPEED = float(LIMITS.top_speed[JOINT])


def turned_back(state: Excitation, by: float, quick: bool) -> Excitation:
    """``state`` after a triangle whose speed fell when its command had turned back ``by``."""
    stroke = Stroke(JOINT, StrokeKind.RAMP, True, TOP_SPEED if quick else 0.5 * TOP_SPEED)
    rim = np.full_like(state.rim, 0.14)  # hardly open: a turn at the ramp's own rate
    at = state._replace(phase=Phase.TURNING, top=0.16, spool=0.16 - by, rim=rim)
    return with_slack(LIMITS, at, stroke)


@pytest.mark.parametrize("second", [0.06, 0.045])
def test_of_slow_triangles_the_shortest_holds_and_quick_ones_tell_nothing(second: float) -> None:
    first = turned_back(begun(START), 0.05, quick=False)
    known = float(first.slack[JOINT])
    assert 0.04 < known < 0.05  # less than was turned back: the lag is left out
    for by in (0.09, 0.03):
        swung = turned_back(first, by, quick=True)
        assert swung.phase is Phase.FALLING
        assert float(swung.slack[JOINT]) == known
    again = turned_back(swung, second, quick=False)
    assert float(again.slack[JOINT]) == pytest.approx(known + min(second - 0.05, 0.0), abs=1e-12)
