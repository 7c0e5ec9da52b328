"""The slew's play: it moves the tool by millimetres at the end of a long boom, and the encoder sees none.

A joint drags its encoder along, so that after a turn in one sense it stands half the play ahead of what the
encoder tells, and after a turn in the other as much behind. Which of the two a long drive leaves is chance:
it overshoots and comes back. Every watched path therefore ends with the same short, slow turn in the positive
sense, as machinists approach a dimension from one side: all rests are on one flank, and the play drops out.
"""

import numpy as np

from vision_pc.core.se3 import Array, transform


def taken_up(X_BT: Array, turn_rad: float) -> Array:
    """The pose (4, 4) from which a turn of the slew by ``turn_rad`` ends at ``X_BT``, tool's axes held."""
    return transform(X_BT[:3, :3], X_BT[:3, 3] - turn_rad * slew_lever(X_BT))


def slew_lever(X_BT: Array) -> Array:
    """Displacement (3,) of the TCP at ``X_BT`` in B for each radian of slew, m/rad."""
    return np.array([-X_BT[1, 3], X_BT[0, 3], 0.0])


def slew_between(X_BT: Array, Y_BT: Array) -> float:
    """The turn (rad) of the slew that is in the small step between two poses (4, 4)."""
    lever = slew_lever(X_BT)
    return float(lever @ (Y_BT[:3, 3] - X_BT[:3, 3]) / (lever @ lever))


def slew_angles(X_BT: Array, wrist_to_tool_m: float) -> Array:
    """Slew angles (N,) rad of poses (N, 4, 4): the wrist's centre lies on the slew plane."""
    wrist = X_BT[:, :3, 3] - wrist_to_tool_m * X_BT[:, :3, 2]
    return np.asarray(np.unwrap(np.arctan2(wrist[:, 1], wrist[:, 0])))


def play_states(slew: Array, reversal: float) -> Array:
    """h (N,) in −1…1: on which flank of the play the slew's load side lies; −1 after a positive turn.

    The joint has crossed its whole play before the encoder turns back at all; ``reversal`` is half of what
    the encoder must turn back (rad) to be believed.
    """
    states = np.zeros(len(slew))
    for i in range(1, len(slew)):
        turn = float(slew[i] - slew[i - 1])
        states[i] = min(max(float(states[i - 1]) - turn / reversal, -1.0), 1.0)
    return states
