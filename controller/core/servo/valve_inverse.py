"""From a wanted flow to a spool command: what a valve does, undone.

A valve passes nothing inside its overlap, little where its notches begin, and its spool follows a command
that turns back only after a way of its own (hysteresis).
"""

from controller.core.kinematics.rotations import Array
from foundation.compiled import kernel

_TURN = 0.1  # of the hysteresis: a command that comes back by less has not turned


@kernel
def opening_for(curve: Array, flow: float) -> float:
    """The opening beyond the deadband that passes ``flow``, both shares (≥ 0) of the full ones.

    ``curve``: knots (n, 2) of opening and flow that rise in both, the first (0, 0); beyond the last its slope
    goes on.
    """
    k, last = 0, curve.shape[0] - 2
    while k < last and flow > curve[k + 1, 1]:
        k += 1
    slope = (curve[k + 1, 0] - curve[k, 0]) / (curve[k + 1, 1] - curve[k, 1])
    return float(curve[k, 0] + (flow - curve[k, 1]) * slope)


@kernel
def without_play(wanted: float, half: float, sense: float, furthest: float) -> tuple[float, float, float]:
    """The command that brings a spool with ``half`` a hysteresis to ``wanted``, and what to remember of it.

    ``sense``, ``furthest``: which way the command went before (±1), and how far. The inverse of the play
    operator leads by half its width; it turns over when ``wanted`` has come back by a tenth of the width, so
    that noise does not throw the spool to and fro.
    """
    if half <= 0.0:
        return wanted, sense, furthest
    if sense * (wanted - furthest) >= 0.0:
        furthest = wanted
    elif sense * (furthest - wanted) > 2.0 * _TURN * half:
        sense, furthest = -sense, wanted
    return wanted + sense * half, sense, furthest
