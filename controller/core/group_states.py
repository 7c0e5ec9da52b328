"""The axes group's states: one table, every state and stimulus.

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

# Modes in which the servo drives the valves; in all others they are centred and the enable is dropped.
LIVE = frozenset({Mode.STANDBY, Mode.MOVING, Mode.STREAMING, Mode.STOPPING, Mode.DISABLING, Mode.ERROR_RAMP})


class Stimulus(IntEnum):
    """What can happen to the group: commands under their link numbers, references, its own events."""

    ENABLE = CommandCode.ENABLE
    DISABLE = CommandCode.DISABLE
    STOP = CommandCode.STOP
    RESET = CommandCode.RESET
    EMERGENCY_STOP = CommandCode.EMERGENCY_STOP
    EMERGENCY_RELEASE = CommandCode.EMERGENCY_RELEASE
    START_STREAM = CommandCode.START_STREAM
    END_STREAM = CommandCode.END_STREAM
    MOVE = 16
    STREAMED = 17  # a streamed reference
    STANDSTILL = 18  # the desired motion came to rest
    FAULT_STOP = 19  # a fault that leaves the servo trustworthy
    FAULT_EMERGENCY = 20  # a fault that does not, or whose ramp is over
    UNATTENDED = 21  # the reference link fell silent


class Transition(NamedTuple):
    """The next mode, and the reason that answers a command."""

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

# One column a mode, in the order of Mode; a cell is the next mode's letter and the reason. STOP is always
# accepted. Modes: D disabled, S standby, M moving, F following a stream, T stopping, G disabling, R error
# ramp, H error held, E emergency. A silent link does not end F: its references go stale, which is sooner.
_TABLE = {
    Stimulus.ENABLE: "S/ok    S/done  M/done  F/done  T/done  G/busy  R/error H/error E/latch",
    Stimulus.DISABLE: "D/done  D/ok    G/ok    G/ok    G/ok    G/done  R/error H/done  E/done",
    Stimulus.STOP: "D/ok    S/ok    T/ok    T/ok    T/ok    G/ok    R/ok    H/ok    E/ok",
    Stimulus.RESET: "D/none  S/none  M/none  F/none  T/none  G/none  R/busy  D/ok    E/latch",
    Stimulus.EMERGENCY_STOP: "E/ok    E/ok    E/ok    E/ok    E/ok    E/ok    E/ok    E/ok    E/done",
    Stimulus.EMERGENCY_RELEASE: "D/done  S/done  M/done  F/done  T/done  G/done  R/done  H/done  H/ok",
    Stimulus.START_STREAM: "D/off   F/ok    M/move  F/flow  T/busy  G/busy  R/error H/error E/latch",
    Stimulus.END_STREAM: "D/dry   S/dry   M/dry   M/ok    T/dry   G/dry   R/dry   H/dry   E/dry",
    Stimulus.MOVE: "D/off   M/ok    M/ok    F/flow  T/busy  G/busy  R/error H/error E/latch",
    Stimulus.STREAMED: "D/off   S/dry   M/dry   F/ok    T/busy  G/busy  R/error H/error E/latch",
    Stimulus.STANDSTILL: "D/ok    S/ok    S/ok    F/ok    S/ok    D/ok    H/ok    H/ok    E/ok",
    Stimulus.FAULT_STOP: "D/ok    R/ok    R/ok    R/ok    R/ok    R/ok    R/ok    H/ok    E/ok",
    Stimulus.FAULT_EMERGENCY: "D/ok    H/ok    H/ok    H/ok    H/ok    H/ok    H/ok    H/ok    E/ok",
    Stimulus.UNATTENDED: "D/ok    D/ok    R/ok    F/ok    G/ok    G/ok    R/ok    H/ok    E/ok",
}

TRANSITIONS: dict[tuple[Mode, Stimulus], Transition] = {
    (mode, stimulus): Transition(_MODES[cell[0]], _REASONS[cell[2:]])
    for stimulus, row in _TABLE.items()
    for mode, cell in zip(Mode, row.split(), strict=True)
}


def transition(mode: Mode, stimulus: Stimulus) -> Transition:
    """The next mode and the reason; defined for every pair."""
    return TRANSITIONS[mode, stimulus]
