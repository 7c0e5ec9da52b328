"""The axes group's states: one table, every state and stimulus.

How requests are answered is the protocol's table; what the group does by itself stands here.
"""

from enum import IntEnum

from protocol.axes_group import ANSWERS, GroupRequest, Mode, Transition, table_row

# Modes in which the servo drives the valves; in all others they are centred and the enable is dropped.
LIVE = frozenset({Mode.STANDBY, Mode.MOVING, Mode.STREAMING, Mode.STOPPING, Mode.DISABLING, Mode.ERROR_RAMP})


class Stimulus(IntEnum):
    """What can happen to the group: what can be asked, under the same numbers, and its own events."""

    ENABLE = GroupRequest.ENABLE
    DISABLE = GroupRequest.DISABLE
    STOP = GroupRequest.STOP
    RESET = GroupRequest.RESET
    EMERGENCY_STOP = GroupRequest.EMERGENCY_STOP
    EMERGENCY_RELEASE = GroupRequest.EMERGENCY_RELEASE
    START_STREAM = GroupRequest.START_STREAM
    END_STREAM = GroupRequest.END_STREAM
    MOVE = GroupRequest.MOVE
    STREAMED = GroupRequest.STREAMED
    STANDSTILL = 18  # the desired motion came to rest
    FAULT_STOP = 19  # a fault that leaves the servo trustworthy
    FAULT_EMERGENCY = 20  # a fault that does not, or whose ramp is over
    UNATTENDED = 21  # the reference link fell silent


# A silent link does not end the following of a stream: its references go stale, which is sooner.
_OWN = {
    Stimulus.STANDSTILL: "D/ok    S/ok    S/ok    F/ok    S/ok    D/ok    H/ok    H/ok    E/ok",
    Stimulus.FAULT_STOP: "D/ok    R/ok    R/ok    R/ok    R/ok    R/ok    R/ok    H/ok    E/ok",
    Stimulus.FAULT_EMERGENCY: "D/ok    H/ok    H/ok    H/ok    H/ok    H/ok    H/ok    H/ok    E/ok",
    Stimulus.UNATTENDED: "D/ok    D/ok    R/ok    F/ok    G/ok    G/ok    R/ok    H/ok    E/ok",
}

TRANSITIONS: dict[tuple[Mode, Stimulus], Transition] = {
    **{(mode, Stimulus(request)): step for (mode, request), step in ANSWERS.items()},
    **{(mode, stimulus): step for stimulus, row in _OWN.items() for mode, step in table_row(row).items()},
}


def transition(mode: Mode, stimulus: Stimulus) -> Transition:
    """The next mode and the reason; defined for every pair."""
    return TRANSITIONS[mode, stimulus]
