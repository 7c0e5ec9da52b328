"""The controller's newest states, and the tool's pose at any instant between them."""

from collections import deque

from protocol.errors import LinkLost
from protocol.reference_messages import State
from vision_pc.core.se3 import Array, from_pose, interpolate

_KEPT_NS = 30_000_000_000
_GAP_NS = 300_000_000  # states further apart than this are not interpolated between


def keep(states: deque[State], state: State) -> None:
    """Append the newest state to those of a session, in order, of which the last 30 s are kept."""
    states.append(state)
    while state.time_ns - states[0].time_ns > _KEPT_NS:
        states.popleft()


def pose_at(states: deque[State], time_ns: int) -> Array:
    """X_BT (4, 4) at ``time_ns`` of the controller's clock, which the newest state reaches, interpolated
    between its neighbours.

    Raises LinkLost: ``link.state_too_old`` before the first state, ``link.state_gap`` between two states
    that are more than 300 ms apart.
    """
    newer = states[-1]
    for older in reversed(states):
        if older.time_ns <= time_ns:
            return _between(older, newer, time_ns)
        newer = older
    raise LinkLost("link.state_too_old", "the pose asked for is older than the states that are kept")


def _between(older: State, newer: State, time_ns: int) -> Array:
    span_ns = newer.time_ns - older.time_ns
    if span_ns > _GAP_NS:
        why = f"states {span_ns / 1e6:.0f} ms apart, limit {_GAP_NS / 1e6:.0f} ms"
        raise LinkLost("link.state_gap", why)
    fraction = (time_ns - older.time_ns) / span_ns if span_ns else 0.0
    return interpolate(from_pose(older.X_BT), from_pose(newer.X_BT), fraction)
