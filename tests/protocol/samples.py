"""One example of every message, with every number different, and hypothesis strategies for all of them."""

from hypothesis import strategies as st

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

u16 = st.integers(0, 2**16 - 1)
u32 = st.integers(0, 2**32 - 1)
u64 = st.integers(0, 2**64 - 1)
positive_u64 = st.integers(1, 2**64 - 1)
ms = st.integers(0, 60_000)
reals = st.floats(allow_nan=False)
six = st.tuples(*[reals] * 6)
poses = st.builds(Pose, st.tuples(*[reals] * 3), st.tuples(*[reals] * 4))
headers = st.builds(Header, u64, u32, u64, u32, st.integers(0, 255), st.integers(0, 255))

messages = st.one_of(
    st.builds(Hello, positive_u64, u64, u64, ms),
    st.builds(
        Welcome, positive_u64, u64, u64, positive_u64, st.integers(1, 2**32 - 1), st.integers(1, 60_000), ms
    ),
    st.builds(Heartbeat, u64),
    st.builds(HeartbeatReply, u64, u64, u64),
    st.builds(ReferencePose, positive_u64, poses, reals),
    st.builds(ReferencePath, positive_u64, st.lists(poses, min_size=1, max_size=24).map(tuple), reals, reals),
    st.builds(Command, positive_u64, st.sampled_from(CommandCode)),
    st.builds(Acknowledgement, positive_u64, st.sampled_from(Reason), reals, reals),
    st.builds(
        State, u64, u64, st.sampled_from(GroupState), st.sampled_from(FaultCode), st.sampled_from(Severity),
        u16, u64, st.booleans(), u32, six, six, six, poses, poses, reals, u32, u32, u32, u32, u32, u32, u32,
        u32,
    ),
    st.builds(Bye, st.sampled_from(Reason)),
    st.builds(StreamedPose, positive_u64, u32, u64, poses, six),
    st.builds(StreamRefused, positive_u64, u32, st.sampled_from(Reason), reals, reals),
)  # fmt: skip
