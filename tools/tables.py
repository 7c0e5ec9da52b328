"""Markdown tables of the written protocol that follow from the code: numbers with names, and limits."""

from collections.abc import Iterable
from enum import IntEnum
from pathlib import Path
from typing import TypeVar

from controller.config import ControllerConfig
from controller.core.inbox import WAITING
from controller.core.trajectories.path_survey import JOINT_MARGIN_DEG
from foundation.configuration import load
from nominal_arm.description import NominalArm
from protocol.axes_group import ANSWERS, GroupRequest, Mode
from protocol.channel import MAX_GAP_DATAGRAMS, WINDOW_DATAGRAMS
from protocol.client_handshake import HELLO_PERIOD_NS, HELLOS_PER_NONCE
from protocol.client_session import MIN_RESEND_NS, RESEND_CYCLES
from protocol.clock_offset import (
    DISPUTED_TO_RESET,
    DRIFT_PPM,
    FIRST_HEARTBEATS,
    FIRST_PERIOD_NS,
    HEARTBEATS_PER_TIMEOUT,
    WINDOW,
)
from protocol.command_ledger import REMEMBERED
from protocol.datagram_layout import MAX_DATAGRAM_BYTES, MAX_WAYPOINTS
from protocol.faults import (
    COMMAND_TEXTS,
    FAULT_TEXTS,
    GROUP_STATE_TEXTS,
    REASON_TEXTS,
    SEVERITY_TEXTS,
    CommandCode,
    FaultCode,
    GroupState,
    Reason,
    Severity,
)
from protocol.server_session import REFUSAL_INTERVAL_NS, REMEMBERED_NONCES


def table(head: str, rows: Iterable[Iterable[object]]) -> str:
    """A Markdown table."""
    columns = [cell.strip() for cell in head.split("|")]
    head, *body = ("| " + " | ".join(map(str, line)) + " |" for line in (columns, *rows))
    return "\n".join([head, "|---" * len(columns) + "|", *body])


ROOT = Path(__file__).parents[1]
CONFIGS = ROOT / "configs"
Member = TypeVar("Member", bound=IntEnum)
COLUMNS = {GroupRequest.MOVE: "reference", GroupRequest.STREAMED: "streamed reference"}
MS = 1_000_000


def limits() -> str:
    """Every time and count of the protocol, in milliseconds and in packets."""
    rows = [
        ("largest datagram", f"{MAX_DATAGRAM_BYTES} bytes, with its trailer", ""),
        ("waypoints in a path", MAX_WAYPOINTS, ""),
        ("HELLO repeated", f"every {HELLO_PERIOD_NS // MS} ms", f"new nonce after {HELLOS_PER_NONCE}"),
        ("HEARTBEAT", f"every link_timeout_ms / {HEARTBEATS_PER_TIMEOUT}",
         f"the first {FIRST_HEARTBEATS} at most {FIRST_PERIOD_NS // MS} ms apart"),
        ("session ends by silence", "after more than link_timeout_ms",
         f"{HEARTBEATS_PER_TIMEOUT - 1} heartbeats lost in a row are survived, one more is not"),
        ("datagram is stale", "older than the controller's max_age_ms, by default link_timeout_ms", ""),
        ("request repeated", f"every {MIN_RESEND_NS // MS} ms or {RESEND_CYCLES} cycles, the longer",
         "until answered"),
        ("requests that wait for a scan", "", f"{WAITING}; one more, and the oldest is overtaken (6.14)"),
        ("answers remembered", "for the session", f"the newest {REMEMBERED}"),
        ("nonces remembered", "", f"those of the last {REMEMBERED_NONCES} sessions"),
        ("gap in the sequence", "", f"at most {MAX_GAP_DATAGRAMS - 1} skipped; more is refused"),
        ("replay window", "", f"the newest {WINDOW_DATAGRAMS} of 2^64 numbers"),
        ("grant that has not begun is forgotten", "after more than link_timeout_ms", ""),
        ("late told from duplicate", "", f"within the newest {WINDOW_DATAGRAMS} numbers"),
        ("BYE to those without a session", f"at most one in {REFUSAL_INTERVAL_NS // MS} ms", ""),
        ("echoes kept for the clock", "", f"the newest {WINDOW}"),
        ("drift of a clock assumed", f"{DRIFT_PPM} ppm", ""),
        ("step of a clock followed", "", f"after {DISPUTED_TO_RESET} echoes in a row that agree"),
    ]  # fmt: skip
    return table("what | limit in time or bytes | limit in packets", rows)


def stream_limits() -> str:
    """What bounds streamed references, as the controller is configured when it is delivered."""
    config = load(ControllerConfig, CONFIGS / "controller.yaml")
    stream, close_ms = config.streaming, config.stream_close_ms
    slow_ms = close_ms - stream.ramp_ms

    def lost_before(limit_ms: float) -> str:
        """References lost in a row whose successor still comes in time, at three rates."""
        return ", ".join(f"{int(limit_ms * rate / 1e3) - 1} at {rate} Hz" for rate in (15, 30, 60))

    rows = [
        ("`silence_ms`", f"{stream.silence_ms:g} ms", ""),
        ("the arm is slowed down after", f"{slow_ms:g} ms at a cycle of {config.cycle_ms:g} ms",
         f"lost in a row without it: {lost_before(slow_ms)}"),
        ("the valves are centred after", f"{close_ms:g} ms at a cycle of {config.cycle_ms:g} ms",
         f"lost in a row and survived: {lost_before(close_ms)}"),
        ("`ramp_ms`, `recovery_ms`", f"{stream.ramp_ms:g} ms, {stream.recovery_ms:g} ms", ""),
        ("`first_reference_ms`", f"{stream.first_reference_ms:g} ms", ""),
        ("greatest age (12.6)", f"{stream.max_age_ms:g} ms", ""),
        ("distance, angle (12.4)", f"{stream.distance_m:g} m, {stream.turn_deg:g}°", ""),
        ("speed, of T and in turning", f"{stream.speed_m_s:g} m/s, {stream.turn_speed_deg_s:g} °/s", ""),
        ("acceleration",
         f"{stream.acceleration_m_s2:g} m/s², {stream.turn_acceleration_deg_s2:g} °/s²", ""),
        ("jerk", f"{stream.jerk_m_s3:g} m/s³, {stream.turn_jerk_deg_s3:g} °/s³", ""),
        ("`twist_ref`, each axis", "0.8 / √3 of the speed", ""),
    ]  # fmt: skip
    return table("what | as delivered | in packets", rows)


def motion_limits() -> str:
    """What bounds poses and paths, as the controller and the arm are configured when delivered."""
    motion = load(ControllerConfig, CONFIGS / "controller.yaml").motion
    space = load(NominalArm, CONFIGS / "arm.yaml").workspace
    box = ", ".join(
        f"{name} {low:g}…{high:g} m"
        for name, (low, high) in (("x", space.x_m), ("y", space.y_m), ("z", space.z_m))
    )
    longest = f"{motion.duration_max_s:g} s"
    rows = [
        ("BAD_DURATION", f"`duration_s`, `segment_s`: 0, or {motion.duration_min_s:g} s…{longest}; "
         f"`dwell_s`: 0…{longest}; the whole: at most {longest}"),
        ("TOO_FAR", f"the first pose within {motion.first_point_distance_m:g} m of the commanded one"),
        ("OUTSIDE_WORKSPACE", f"T in B: {box}; at least {space.radius_min_m:g} m from the slew axis"),
        ("JOINT_LIMIT", f"the joints' ranges of arm.yaml, less {JOINT_MARGIN_DEG:g}°"),
        ("SINGULAR", "least singular value of the Jacobian at a waypoint: at least "
         f"{motion.singular_value_min:g}"),
        ("TOO_FAST", f"{motion.speed_m_s:g} m/s, {motion.acceleration_m_s2:g} m/s², "
         f"{motion.turn_speed_deg_s:g} °/s, {motion.turn_acceleration_deg_s2:g} °/s²; the joints' speeds"),
    ]  # fmt: skip
    return table("refused with | what is accepted", rows)


def enumeration(members: type[Member], texts: dict[Member, str]) -> str:
    """Number, name and meaning of every member."""
    return table("number | name | meaning", ((m.value, m.name, texts[m]) for m in members))


def group_table() -> str:
    """Every command and reference in every mode of the group: the reason that answers, and the next mode."""
    return table(
        "in | " + " | ".join(COLUMNS.get(request, request.name) for request in GroupRequest),
        (
            [
                mode.name,
                *(
                    t.reason.name if t.mode is mode else f"{t.reason.name}→{t.mode.name}"
                    for t in (ANSWERS[mode, request] for request in GroupRequest)
                ),
            ]
            for mode in Mode
        ),
    )


def protocol_sections() -> dict[str, str]:
    """Every generated section of the written protocol by its name."""
    return {
        "limits": limits(),
        "motion limits": motion_limits(),
        "stream limits": stream_limits(),
        "commands": enumeration(CommandCode, COMMAND_TEXTS),
        "group states": enumeration(GroupState, GROUP_STATE_TEXTS),
        "group transitions": group_table(),
        "severities": enumeration(Severity, SEVERITY_TEXTS),
        "reasons": enumeration(Reason, REASON_TEXTS),
        "faults": enumeration(FaultCode, FAULT_TEXTS),
    }
