"""The axes group as its peer sees it: modes, and how each answers every request.

Source: PLCopen Motion Control part 4, axes groups; the emergency stop latches as IEC 60204-1 asks: it
clears only by a release, then a reset, and neither moves anything.
"""

from enum import IntEnum
from typing import NamedTuple

from protocol.faults import CommandCode, GroupState, Reason


class Mode(IntEnum):
    """The group's state with what else decides about the next one."""

    DISABLED = 0
    STANDBY = 1
    MOVING = 2
    STREAMING = 3  # follows streamed references
    STOPPING = 4  # ramps down, then holds
    DISABLING = 5  # ramps down, then drops the enable
    ERROR_RAMP = 6  # a fault: ramps down, then drops the enable
    ERROR_HELD = 7  # a fault: valves centred, enable dropped
    EMERGENCY = 8  # emergency stop latched: valves centred, enable dropped


GROUP_STATE = {
    Mode.DISABLED: GroupState.DISABLED,
    Mode.STANDBY: GroupState.STANDBY,
    Mode.MOVING: GroupState.MOVING,
    Mode.STREAMING: GroupState.MOVING,
    Mode.STOPPING: GroupState.STOPPING,
    Mode.DISABLING: GroupState.STOPPING,
    Mode.ERROR_RAMP: GroupState.ERROR_STOP,
    Mode.ERROR_HELD: GroupState.ERROR_STOP,
    Mode.EMERGENCY: GroupState.ERROR_STOP,
}


class GroupRequest(IntEnum):
    """What a client can ask of the group: commands under their link numbers, and references."""

    ENABLE = CommandCode.ENABLE
    DISABLE = CommandCode.DISABLE
    STOP = CommandCode.STOP
    RESET = CommandCode.RESET
    EMERGENCY_STOP = CommandCode.EMERGENCY_STOP
    EMERGENCY_RELEASE = CommandCode.EMERGENCY_RELEASE
    START_STREAM = CommandCode.START_STREAM
    END_STREAM = CommandCode.END_STREAM
    MOVE = 16  # a reference
    STREAMED = 17  # a streamed reference


class Transition(NamedTuple):
    """The next mode, and the reason that answers a request."""

    mode: Mode
    reason: Reason


_MODES = dict(zip("DSMFTGRHE", Mode, strict=True))
_REASONS = {
    "ok": Reason.ACCEPTED,
    "done": Reason.ALREADY_DONE,
    "off": Reason.DISABLED,
    "busy": Reason.STOPPING,
    "none": Reason.NOT_IN_ERROR,
    "error": Reason.ERROR_LATCHED,
    "latch": Reason.EMERGENCY_LATCHED,
    "move": Reason.MOVING,
    "flow": Reason.STREAMING,
    "dry": Reason.NOT_STREAMING,
}


def table_row(row: str) -> dict[Mode, Transition]:
    """One row of a table as text: a cell a mode, in the order of Mode, the next mode's letter and the reason.

    Modes: D disabled, S standby, M moving, F following a stream, T stopping, G disabling, R error ramp,
    H error held, E emergency.
    """
    cells = zip(Mode, row.split(), strict=True)
    return {mode: Transition(_MODES[cell[0]], _REASONS[cell[2:]]) for mode, cell in cells}


# STOP is always accepted.
_TABLE = {
    GroupRequest.ENABLE: "S/ok    S/done  M/done  F/done  T/done  G/busy  R/error H/error E/latch",
    GroupRequest.DISABLE: "D/done  D/ok    G/ok    G/ok    G/ok    G/done  R/error H/done  E/done",
    GroupRequest.STOP: "D/ok    S/ok    T/ok    T/ok    T/ok    G/ok    R/ok    H/ok    E/ok",
    GroupRequest.RESET: "D/none  S/none  M/none  F/none  T/none  G/none  R/busy  D/ok    E/latch",
    GroupRequest.EMERGENCY_STOP: "E/ok    E/ok    E/ok    E/ok    E/ok    E/ok    E/ok    E/ok    E/done",
    GroupRequest.EMERGENCY_RELEASE: "D/done  S/done  M/done  F/done  T/done  G/done  R/done  H/done  H/ok",
    GroupRequest.START_STREAM: "D/off   F/ok    M/move  F/flow  T/busy  G/busy  R/error H/error E/latch",
    GroupRequest.END_STREAM: "D/dry   S/dry   M/dry   M/ok    T/dry   G/dry   R/dry   H/dry   E/dry",
    GroupRequest.MOVE: "D/off   M/ok    M/ok    F/flow  T/busy  G/busy  R/error H/error E/latch",
    GroupRequest.STREAMED: "D/off   S/dry   M/dry   F/ok    T/busy  G/busy  R/error H/error E/latch",
}

ANSWERS: dict[tuple[Mode, GroupRequest], Transition] = {
    (mode, request): step for request, row in _TABLE.items() for mode, step in table_row(row).items()
}
