"""STATEs on the tester's clock, by the offset that heartbeats bound (5.5); and poses turned."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from conformance.peer import Peer
from conformance.wire import MS, require
from protocol.clock_offset import ClockOffset
from protocol.pose import Pose
from protocol.reference_messages import State

_ECHOES = 12


class Watched(NamedTuple):
    """A STATE with the instants (ns, tester's clock) of its scan and of its arrival."""

    scan_ns: int
    came_ns: int
    state: State

    @property
    def age_ms(self) -> float:
        """How old it was when it came."""
        return (self.came_ns - self.scan_ns) / MS


class StateWatch:
    """STATEs of a peer on the tester's clock; to be made with the session open."""

    def __init__(self, peer: Peer) -> None:
        self.peer = peer
        clock = ClockOffset()
        for _ in range(_ECHOES):
            reply = peer.alive("a heartbeat")
            clock.add(reply.sent_ns, reply.received_ns, reply.replied_ns, peer.now_ns)
        found = clock.estimate(peer.now_ns)
        require(found is not None, "no offset fits the echoes of the heartbeats")
        assert found is not None
        self.offset_ns = found.offset_ns
        self.uncertainty_ms = found.uncertainty_ns / MS

    def next(self, wait_ms: float = 500.0) -> Watched:
        """The next STATE; raises Failed when none comes."""
        state = self.peer.expect(State, "STATE", wait_ms)
        return Watched(state.time_ns - self.offset_ns, self.peer.now_ns, state)

    def during(self, wait_ms: float, until: Callable[[State], bool] = lambda state: False) -> list[Watched]:
        """The STATEs of ``wait_ms``, or until one, the last, is as wanted."""
        seen: list[Watched] = []
        until_ns = self.peer.now_ns + int(wait_ms * MS)
        while self.peer.now_ns < until_ns:
            seen.append(self.next())
            if until(seen[-1].state):
                break
        return seen


def angle_between(a: Sequence[float], b: Sequence[float]) -> float:
    """The angle (rad) of the turn between two unit quaternions."""
    return 2.0 * math.acos(min(1.0, abs(sum(x * y for x, y in zip(a, b, strict=True)))))


def turned(pose: Pose, angle: float, axis: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Pose:
    """``pose`` turned by ``angle`` (rad) about an axis of its own T, by default the last joint's."""
    s = math.sin(angle / 2.0)
    return pose._replace(q_wxyz=_product(pose.q_wxyz, (math.cos(angle / 2.0), *(s * c for c in axis))))


def turned_in_base(pose: Pose, angle: float, axis: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Pose:
    """``pose`` turned by ``angle`` (rad) about an axis of B."""
    s = math.sin(angle / 2.0)
    return pose._replace(q_wxyz=_product((math.cos(angle / 2.0), *(s * c for c in axis)), pose.q_wxyz))


Quaternion = tuple[float, float, float, float]


def _product(a: Sequence[float], b: Sequence[float]) -> Quaternion:
    w, x, y, z = a
    p, q, r, s = b
    return (
        w * p - x * q - y * r - z * s,
        w * q + x * p + y * s - z * r,
        w * r - x * s + y * p + z * q,
        w * s + x * r - y * q + z * p,
    )
