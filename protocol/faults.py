"""Enumerations that several parties share: group states, commands, reasons and fault codes.

Numbers are part of the written protocol: never renumber, only append.
"""

from enum import IntEnum


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
    INCOMPATIBLE_VERSION = 40
    WRONG_ARM = 41
    SESSION_OCCUPIED = 42
    UNKNOWN_SESSION = 43
    PEER_RESTARTED = 44
    LINK_TIMEOUT = 45
    SHUTDOWN = 46


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


class Severity(IntEnum):
    """How the controller reacted to its latched fault."""

    NONE = 0
    WARNING = 1
    STOP = 2
    EMERGENCY = 3
