"""Enumerations that several parties share: group states, commands, reasons and fault codes.

Numbers are part of the written protocol: never renumber, only append.
"""

import math
from enum import IntEnum

from protocol.errors import RequestRefused


class GroupState(IntEnum):
    """States of the axes group, PLCopen Motion Control part 4."""

    DISABLED = 0
    STANDBY = 1
    MOVING = 2
    STOPPING = 3
    ERROR_STOP = 4


class CommandCode(IntEnum):
    """What a COMMAND datagram asks for."""

    ENABLE = 1
    DISABLE = 2
    STOP = 3
    RESET = 4
    EMERGENCY_STOP = 5
    EMERGENCY_RELEASE = 6
    START_STREAM = 7
    END_STREAM = 8


class Reason(IntEnum):
    """Why a command or reference was accepted or refused; one code for each kind of refusal."""

    ACCEPTED = 0
    DISABLED = 1
    NOT_IN_ERROR = 2
    ERROR_LATCHED = 3
    EMERGENCY_LATCHED = 4
    STOPPING = 5
    ALREADY_DONE = 6
    NOT_FINITE = 10
    NOT_UNIT_QUATERNION = 11
    OUTSIDE_WORKSPACE = 12
    JOINT_LIMIT = 13
    UNREACHABLE = 14
    SINGULAR = 15
    TOO_FAST = 16
    TOO_FAR = 17
    BAD_DURATION = 18
    EMPTY_PATH = 19
    TOO_MANY_WAYPOINTS = 20
    PLANT_LINK_DOWN = 21
    REFERENCE_LINK_DOWN = 22
    PLANT_NOT_READY = 23
    UNKNOWN_COMMAND = 24
    REPEATED_COMMAND_ID = 25
    OVERTAKEN = 26
    NOT_NEGOTIATED = 27
    MOVING = 28
    STREAMING = 29
    NOT_STREAMING = 30
    STALE = 31
    INCOMPATIBLE_VERSION = 40
    WRONG_ARM = 41
    SESSION_OCCUPIED = 42
    UNKNOWN_SESSION = 43
    PEER_RESTARTED = 44
    LINK_TIMEOUT = 45
    SHUTDOWN = 46
    NOT_AUTHENTICATED = 47
    KEY_NOT_CONFIGURED = 48
    UNKNOWN_KEY = 49
    BAD_TAG = 50


class FaultCode(IntEnum):
    """First fault latched by the controller."""

    NONE = 0
    PLANT_LINK_LOST = 1
    PLANT_CYCLE_FROZEN = 2
    REFERENCE_LINK_LOST = 3
    FOLLOWING_ERROR = 4
    ENCODER_JUMP = 5
    ENCODER_STUCK = 6
    JOINT_LIMIT = 7
    WORKSPACE_LIMIT = 8
    OVERSPEED = 9
    SUPPLY_PRESSURE_LOST = 10
    PLANT_WATCHDOG = 11
    EMERGENCY_STOP = 12
    NUMERIC = 13
    OVERRUN = 14
    PLANT_STATUS = 15
    REFERENCE_STALE = 16


class Severity(IntEnum):
    """How the controller reacted to its latched fault."""

    NONE = 0
    WARNING = 1
    STOP = 2
    EMERGENCY = 3


# What each number means; the written protocol and the faces for people take their words from here.

COMMAND_TEXTS: dict[CommandCode, str] = {
    CommandCode.ENABLE: "let the controller drive the valves; the arm holds where it is",
    CommandCode.DISABLE: "ramp down, then centre the valves and drop the enable",
    CommandCode.STOP: "ramp down and hold; always accepted",
    CommandCode.RESET: "clear a latched fault once its cause has gone; moves nothing",
    CommandCode.EMERGENCY_STOP: "centre the valves at once and latch",
    CommandCode.EMERGENCY_RELEASE: "release the latched emergency stop; RESET and ENABLE must follow",
    CommandCode.START_STREAM: "follow streamed references; the command's id names the stream",
    CommandCode.END_STREAM: "go on to the newest streamed reference, rest there, follow no further ones",
}

GROUP_STATE_TEXTS: dict[GroupState, str] = {
    GroupState.DISABLED: "valves centred, enable dropped",
    GroupState.STANDBY: "enabled, holding the commanded pose",
    GroupState.MOVING: "following a reference",
    GroupState.STOPPING: "ramping down",
    GroupState.ERROR_STOP: "a fault or the emergency stop is latched",
}

SEVERITY_TEXTS: dict[Severity, str] = {
    Severity.NONE: "no fault",
    Severity.WARNING: "noted, the motion goes on",
    Severity.STOP: "ramped down, then valves centred and enable dropped",
    Severity.EMERGENCY: "valves centred and enable dropped in the same scan",
}

# "v" and "l" are the fields value and limit of the acknowledgement; where not named they are 0.
REASON_TEXTS: dict[Reason, str] = {
    Reason.ACCEPTED: "accepted; in BYE: no particular reason",
    Reason.DISABLED: "the group is not enabled",
    Reason.NOT_IN_ERROR: "nothing to reset",
    Reason.ERROR_LATCHED: "a fault is latched: RESET first",
    Reason.EMERGENCY_LATCHED: "the emergency stop is latched: EMERGENCY_RELEASE, then RESET",
    Reason.STOPPING: "the arm is still ramping down",
    Reason.ALREADY_DONE: "the group is already where the command leads; nothing changes",
    Reason.NOT_FINITE: (
        "NaN, infinity or a subnormal; v index of the pose, l number of poses, 0 and 0 for a time"
    ),
    Reason.NOT_UNIT_QUATERNION: "the norm is off 1 by more than 1e-3; v the norm, l 1",
    Reason.OUTSIDE_WORKSPACE: "v the coordinate or radius in m, l its bound",
    Reason.JOINT_LIMIT: "a joint would leave its range on the way; v its angle in rad, l the bound",
    Reason.UNREACHABLE: "no joint angles lead there; v the distance in m, l the reach",
    Reason.SINGULAR: "too near a singularity; v the singular value or a joint's turn in rad, l the limit",
    Reason.TOO_FAST: "the given time is too short; v the peak (SI) or its ratio to the limit, l the limit",
    Reason.TOO_FAR: "the first pose is too far from the present one; v the distance in m, l the bound",
    Reason.BAD_DURATION: "a time is negative, too short or too long; v the time in s, l the bound",
    Reason.EMPTY_PATH: "a path without a waypoint; v 0, l 1",
    Reason.TOO_MANY_WAYPOINTS: "v the number of waypoints, l the most allowed",
    Reason.PLANT_LINK_DOWN: "the controller does not hear the plant",
    Reason.REFERENCE_LINK_DOWN: "the reference link is not alive",
    Reason.PLANT_NOT_READY: "the plant reports no supply, a tripped watchdog or a sensor fault",
    Reason.UNKNOWN_COMMAND: "the command's code is not in the table; v the code",
    Reason.REPEATED_COMMAND_ID: "the id was used for another request",
    Reason.OVERTAKEN: (
        "something newer came first; v this one's id or number, l the newest's or that of what overtook it"
    ),
    Reason.NOT_NEGOTIATED: "the request needs a capability that was not granted",
    Reason.MOVING: "the arm is in another motion: STOP or wait first",
    Reason.STREAMING: "streamed references are being followed: END_STREAM or STOP first",
    Reason.NOT_STREAMING: (
        "no such stream is open: START_STREAM first; v the id that a reference names, l the open one's, or 0"
    ),
    Reason.STALE: "what the reference rests on is too old; v its age in s, l the limit",
    Reason.INCOMPATIBLE_VERSION: "in BYE: the major version is not spoken here",
    Reason.WRONG_ARM: "in BYE: the hash of the arm's configuration is another",
    Reason.SESSION_OCCUPIED: "in BYE: another client is connected; ask again",
    Reason.UNKNOWN_SESSION: "in BYE: no such session, or no longer",
    Reason.PEER_RESTARTED: "the client came back under a new nonce",
    Reason.LINK_TIMEOUT: "in BYE: the peer was silent for longer than the link timeout",
    Reason.SHUTDOWN: "in BYE: the sender ends in good order",
    Reason.NOT_AUTHENTICATED: "in BYE: a key is configured here, and HELLO was not signed",
    Reason.KEY_NOT_CONFIGURED: "in BYE: HELLO was signed, and no key is configured here",
    Reason.UNKNOWN_KEY: "in BYE: HELLO was signed with another key than the one configured here",
    Reason.BAD_TAG: "in BYE: the tag of HELLO is not the one of its content",
}

# The unit of "v" and "l", where they always have the same one.
REASON_UNITS: dict[Reason, str] = {
    Reason.OUTSIDE_WORKSPACE: "m",
    Reason.JOINT_LIMIT: "rad",
    Reason.UNREACHABLE: "m",
    Reason.TOO_FAR: "m",
    Reason.BAD_DURATION: "s",
    Reason.STALE: "s",
}

FAULT_TEXTS: dict[FaultCode, str] = {
    FaultCode.NONE: "no fault",
    FaultCode.PLANT_LINK_LOST: "the fieldbus did not answer, or did not confirm the controller's outputs",
    FaultCode.PLANT_CYCLE_FROZEN: "the plant answers but its cycle stands still",
    FaultCode.REFERENCE_LINK_LOST: "the client's session ended while the arm moved",
    FaultCode.FOLLOWING_ERROR: "a joint does not follow its command",
    FaultCode.ENCODER_JUMP: "an encoder leapt further than the joint can turn",
    FaultCode.ENCODER_STUCK: "an encoder stands still although its valve is open",
    FaultCode.JOINT_LIMIT: "a joint left its range",
    FaultCode.WORKSPACE_LIMIT: "the tool left the workspace",
    FaultCode.OVERSPEED: "the tool is faster than allowed",
    FaultCode.SUPPLY_PRESSURE_LOST: "the supply pressure is too low",
    FaultCode.PLANT_WATCHDOG: "the plant's own watchdog closed the valves",
    FaultCode.EMERGENCY_STOP: "the emergency stop was asked for",
    FaultCode.NUMERIC: "the controller computed a number that is not finite",
    FaultCode.OVERRUN: "the scan was too late",
    FaultCode.PLANT_STATUS: "the plant reports a fault in its status word",
    FaultCode.REFERENCE_STALE: "no fresh reference came in time while streamed ones were followed",
}


def refusal(what: str, reason: Reason, value: float, limit: float, which: str = "") -> RequestRefused:
    """The exception for a refused ``what``, in words for people; its cause is ``refused.`` and the reason.

    ``which``: whose limit or what fault it is, where that is known: "of lift", "by overspeed".
    """
    words = reason.name.lower()
    numbers = (
        f": {_number_with_unit(reason, value)}, limit {_number_with_unit(reason, limit)}"
        if value or limit
        else ""
    )
    named = f" {which}" if which else ""
    return RequestRefused(f"refused.{words}", f"{what} refused: {words.replace('_', ' ')}{named}{numbers}")


def _number_with_unit(reason: Reason, number: float) -> str:
    """Angles are told in degrees, as everywhere on the faces for people."""
    unit = REASON_UNITS.get(reason)
    if unit == "rad":
        return f"{math.degrees(number):.2f} deg"
    return f"{number:g} {unit}" if unit else f"{number:g}"
