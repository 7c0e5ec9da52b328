"""One example of every message, each number different: the examples of docs/protocol.md."""

from protocol.datagram import Header
from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.pose import Pose
from protocol.reference_messages import (
    Acknowledgement,
    Bye,
    Command,
    Heartbeat,
    HeartbeatReply,
    Hello,
    Message,
    ReferencePath,
    ReferencePose,
    State,
    StreamedPose,
    StreamRefused,
    Welcome,
)

HEADER = Header(session=0x1122334455667788, sequence=0x99AABBCC, sent_ns=1_234_567_890_123, echo_sequence=77)
POSE = Pose((3.89355, -0.125, 1.00825), (0.5, -0.5, 0.5, -0.5))
OTHER_POSE = Pose((4.25, 0.375, 0.875), (0.6, 0.0, 0.8, 0.0))

MESSAGES: tuple[Message, ...] = (
    Hello(0x0102030405060708, 0b101, 0xA1A2A3A4A5A6A7A8, 20),
    Welcome(0x0102030405060708, 0b001, 0xA1A2A3A4A5A6A7A8, 0xB1B2B3B4B5B6B7B8, 5_000_000, 250, 20),
    Heartbeat(987_654_321),
    HeartbeatReply(987_654_321, 1_987_654_321, 1_987_700_000),
    ReferencePose(41, POSE, 2.5),
    ReferencePath(42, (POSE, OTHER_POSE), 1.5, 0.25),
    Command(43, CommandCode.STOP),
    Acknowledgement(43, Reason.JOINT_LIMIT, 1.75, 1.5),
    State(
        time_ns=5_000_000_123,
        cycle=1_000_025,
        group_state=GroupState.MOVING,
        fault=FaultCode.FOLLOWING_ERROR,
        severity=Severity.STOP,
        flags=0b101,
        motion_id=42,
        motion_done=True,
        segment=3,
        q_meas=(0.01, 0.02, 0.03, 0.04, 0.05, 0.06),
        q_cmd=(0.11, 0.12, 0.13, 0.14, 0.15, 0.16),
        valves=(-0.1, -0.2, -0.3, 0.4, 0.5, 0.6),
        X_BT=POSE,
        X_BT_cmd=OTHER_POSE,
        supply_bar=201.25,
        overruns=1,
        lateness_p50_us=63,
        lateness_p99_us=1119,
        lateness_max_us=6220,
        references_lost=4,
        references_dropped=5,
        plant_exchange_failures=6,
        stream_number=7,
    ),
    Bye(Reason.SHUTDOWN),
    StreamedPose(44, 0xFFFFFFFE, 1_234_500_000_000, POSE, (0.01, -0.02, 0.03, -0.04, 0.05, -0.06)),
    StreamRefused(44, 0xFFFFFFFF, Reason.TOO_FAR, 0.75, 0.5),
)
