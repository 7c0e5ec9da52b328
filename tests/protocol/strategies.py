"""Hypothesis strategies for every message of the reference link."""

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
    ReferencePath,
    ReferencePose,
    State,
    StreamedPose,
    StreamRefused,
    Welcome,
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
