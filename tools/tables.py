"""Markdown tables for the generated parts of pages: cases, limits, sessions."""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from controller.config import ControllerConfig
from controller.core.inbox import WAITING
from controller.core.trajectories.path_survey import JOINT_MARGIN_DEG
from foundation.configuration import load
from nominal_arm.description import NominalArm
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
from protocol.server_session import REFUSAL_INTERVAL_NS, REMEMBERED_NONCES


def table(head: str, rows: Iterable[Iterable[object]]) -> str:
    """A Markdown table."""
    columns = [cell.strip() for cell in head.split("|")]
    head, *body = ("| " + " | ".join(map(str, line)) + " |" for line in (columns, *rows))
    return "\n".join([head, "|---" * len(columns) + "|", *body])


CONFIGS = Path(__file__).parents[1] / "configs"
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


class Row(NamedTuple):
    """In ``state``, after ``event``: the next state, and the datagrams that are sent."""

    state: str
    event: str
    then: str
    sends: str


SERVER_ROWS = (
    Row("CLOSED", "HELLO, nonce not used before, arm_hash 0 or its own", "CLOSED", "WELCOME"),
    Row(
        "CLOSED", "first datagram in the session of the newest WELCOME: HEARTBEAT", "OPEN", "HEARTBEAT_REPLY"
    ),
    Row("CLOSED", "the same, later than link_timeout_ms", "CLOSED", "BYE UNKNOWN_SESSION"),
    Row("CLOSED", "state period has passed since WELCOME", "CLOSED", "–"),
    Row("CLOSED", "HELLO, same source, same nonce", "CLOSED", "the same WELCOME"),
    Row("CLOSED", "HELLO, arm_hash of another arm", "CLOSED", "BYE WRONG_ARM"),
    Row("CLOSED", "HELLO, nonce of an earlier session", "CLOSED", "–"),
    Row("CLOSED", "datagram of another major version", "CLOSED", "BYE INCOMPATIBLE_VERSION"),
    Row("CLOSED", "BYE", "CLOSED", "–"),
    Row("CLOSED", "any other datagram", "CLOSED", "BYE UNKNOWN_SESSION"),
    Row("OPEN", "HELLO, same source, same nonce", "OPEN", "WELCOME"),
    Row("OPEN", "HELLO, same source, new nonce, sent later", "OPEN", "WELCOME"),
    Row(
        "OPEN",
        "first datagram in the session of that WELCOME: HEARTBEAT",
        "OPEN, new session",
        "HEARTBEAT_REPLY",
    ),
    Row("OPEN", "HELLO, same source, new nonce, sent earlier", "OPEN", "–"),
    Row("OPEN", "HELLO, arm_hash of another arm", "OPEN", "BYE WRONG_ARM"),
    Row("OPEN", "HELLO, another source", "OPEN", "BYE SESSION_OCCUPIED"),
    Row("OPEN", "datagram of another major version", "OPEN", "BYE INCOMPATIBLE_VERSION"),
    Row("OPEN", "HEARTBEAT", "OPEN", "HEARTBEAT_REPLY"),
    Row("OPEN", "request, id above all before", "OPEN", "ACKNOWLEDGEMENT after the decision"),
    Row("OPEN", "request again, decided", "OPEN", "the same ACKNOWLEDGEMENT"),
    Row("OPEN", "request again, not yet decided", "OPEN", "–"),
    Row("OPEN", "request, id used, content differs", "OPEN", "ACKNOWLEDGEMENT REPEATED_COMMAND_ID"),
    Row("OPEN", "request, id below the newest and not executed", "OPEN", "ACKNOWLEDGEMENT OVERTAKEN"),
    Row("OPEN", "state period has passed", "OPEN", "STATE"),
    Row("OPEN", "duplicate, late or stale datagram", "OPEN", "–"),
    Row("OPEN", "datagram of this session from another source", "OPEN", "–"),
    Row("OPEN", "datagram of another session, not BYE", "OPEN", "BYE UNKNOWN_SESSION"),
    Row("OPEN", "BYE", "CLOSED", "–"),
    Row("OPEN", "silence for more than link_timeout_ms", "CLOSED", "BYE LINK_TIMEOUT"),
    Row("OPEN", "the controller ends", "CLOSED", "BYE SHUTDOWN"),
)

CLIENT_ROWS = (
    Row("CLOSED", "asked to connect", "CONNECTING", "HELLO"),
    Row("CLOSED", "any datagram", "CLOSED", "–"),
    Row("CONNECTING", "HELLO period has passed", "CONNECTING", "HELLO, same nonce"),
    Row("CONNECTING", "HELLO period has passed after the tenth HELLO", "CONNECTING", "HELLO, new nonce"),
    Row("CONNECTING", "WELCOME with its nonce", "CONNECTED", "HEARTBEAT"),
    Row("CONNECTING", "WELCOME with another nonce", "CONNECTING", "–"),
    Row("CONNECTING", "BYE SESSION_OCCUPIED", "CONNECTING", "–"),
    Row("CONNECTING", "BYE with any other reason", "CLOSED", "–"),
    Row("CONNECTED", "heartbeat period has passed", "CONNECTED", "HEARTBEAT"),
    Row("CONNECTED", "request not answered within the resend time", "CONNECTED", "the request, same id"),
    Row("CONNECTED", "ACKNOWLEDGEMENT of an open request", "CONNECTED", "–"),
    Row("CONNECTED", "BYE of the session", "CLOSED", "–"),
    Row("CONNECTED", "silence for more than link_timeout_ms", "CLOSED", "BYE LINK_TIMEOUT"),
    Row("CONNECTED", "asked to disconnect", "CLOSED", "BYE SHUTDOWN"),
)

# What is added at the controller's end where a key is configured.
KEY_SERVER_ROWS = (
    Row("CLOSED", "HELLO, signed", "CLOSED", "WELCOME"),
    Row("CLOSED", "HELLO, not signed", "CLOSED", "BYE NOT_AUTHENTICATED"),
    Row("CLOSED", "HELLO, signed with another key", "CLOSED", "BYE UNKNOWN_KEY"),
    Row("CLOSED", "HELLO, with a wrong tag", "CLOSED", "BYE BAD_TAG"),
    Row("CLOSED", "first HEARTBEAT under the keys of WELCOME", "OPEN", "HEARTBEAT_REPLY"),
    Row("OPEN", "datagram not signed, of another key or with a wrong tag", "OPEN", "–"),
    Row("OPEN", "replay, or number behind the window", "OPEN", "–"),
    Row("OPEN", "BYE not signed", "OPEN", "–"),
)
