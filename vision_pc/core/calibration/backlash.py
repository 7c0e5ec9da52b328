"""Backlash of the slew: millimetres at the end of a long boom, and the encoder sees none.

A joint drags its encoder along. After a turn in one sense it stands half the backlash ahead of the encoder,
after a turn in the other as much behind. After a long motion the side is random, because the joint overshoots
and returns. Each motion therefore ends with a short, slow turn in the same direction, so that backlash is
always on one side (as a machinist approaches a dimension).
"""

import numpy as np

from vision_pc.core.se3 import Array


def slew_lever(X_BT: Array) -> Array:
    """Displacement (3,) of the TCP at ``X_BT`` in B for each radian of slew, m/rad."""
    return np.array([-X_BT[1, 3], X_BT[0, 3], 0.0])


def slew_angles(X_BT: Array, wrist_to_tool_m: float) -> Array:
    """Slew angles (N,) rad of poses (N, 4, 4): the wrist's centre lies on the slew plane."""
    wrist = X_BT[:, :3, 3] - wrist_to_tool_m * X_BT[:, :3, 2]
    return np.asarray(np.unwrap(np.arctan2(wrist[:, 1], wrist[:, 0])))


def backlash_sides(slew: Array, reversal: float) -> Array:
    """h (N,) in −1…1: the side of the backlash on which the slew's load lies; −1 after a positive turn.

    On a reversal the load crosses the whole backlash before the encoder turns back. An encoder that turns
    back by 2 ``reversal`` (rad) has changed sides: less may be noise.
    """
    states = np.zeros(len(slew))
    for i in range(1, len(slew)):
        turn = float(slew[i] - slew[i - 1])
        states[i] = min(max(float(states[i - 1]) - turn / reversal, -1.0), 1.0)
    return states
