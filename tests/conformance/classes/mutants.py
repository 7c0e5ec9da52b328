# ruff: noqa: E501  (a row is read beside the line that it changes)
"""Controllers with one fault of each class that the generated cases ask for, another than the case names."""

import math
from collections.abc import Callable
from typing import Any

from conformance.wire import with_number
from controller.core.inbox import Inbox
from protocol.datagram import decode
from protocol.datagram_layout import Kind
from protocol.faults import GroupState
from protocol.reference_messages import (
    Bye,
    Command,
    HeartbeatReply,
    ReferencePath,
    ReferencePose,
    State,
    StreamRefused,
    Welcome,
)
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.mutator import BrokenController, Make, edited, follows, hooked, takes
from tests.conformance.systematic_motions import (
    lower_floor,
    named_always,
    named_one_of,
    other_settings,
    reconfigured,
)

C, L, F, S = "channel", "ledger", "factory", "server"
RATION = "if self._refused_at_ns is not None and now_ns - self._refused_at_ns < REFUSAL_INTERVAL_NS:\n            return\n        self._refused_at_ns = now_ns"
OF = "hello.client_nonce == self.welcome.client_nonce"
AGAIN = "                if dropped is None:\n                    self._post(each, each.welcome, now_ns)"
TAKEN = "                self._unconfirmed = None\n                return []"
NUMBER = "self.next_sequence = number + 1"


def _shows(**fields: Callable[[State, Any], Any]) -> Make:
    """Shows fields of STATE otherwise; each gets the STATE and the controller."""
    return hooked(
        shown=lambda self, state: state._replace(**{name: of(state, self) for name, of in fields.items()})
    )


def _hears(drops: Callable[[bytes], bool]) -> Make:
    return hooked(incoming=lambda _, data: b"" if drops(data) else data)


def _sent_ns(data: bytes) -> int:
    return int.from_bytes(data[32:40], "little")


def _place(pose: Any, index: int, change: Callable[[float], float]) -> Any:
    numbers = [*pose.p_m, *pose.q_wxyz]
    numbers[index] = change(numbers[index])
    return pose._replace(p_m=tuple(numbers[:3]), q_wxyz=tuple(numbers[3:]))


def _flushed(value: float) -> float:
    return 0.0 if not math.isfinite(value) or abs(value) < 2.0**-1022 else value


def _negated(names: tuple[str, ...], joint: int) -> Make:
    def of(name: str) -> Callable[[State, Any], Any]:
        return lambda state, _: tuple(-v if j == joint else v for j, v in enumerate(getattr(state, name)))

    return _shows(**{name: of(name) for name in names})


def _counts(by: Callable[[Any, State], int]) -> Make:
    """Counts scans otherwise; ``by`` gets what is added to the count in each scan."""

    def shown(self: Any, state: State) -> State:
        self.added += by(self, state)
        self.before = state
        return state._replace(cycle=state.cycle + self.added)

    return hooked(added=1000, before=None, shown=shown)


def _entered(self: Any, state: State, group: GroupState) -> bool:
    return state.group_state is group and self.before is not None and self.before.group_state is not group


def _ordered(order: Callable[[list[Any]], list[Any]]) -> Make:
    """Takes what waits for a scan in another order."""

    class Otherwise(Inbox):
        def take(self, link_alive: bool) -> Any:
            taken, alive = super().take(link_alive)
            return tuple(order(list(taken))), alive

    return hooked(make_inbox=lambda _: Otherwise())


def _is_reference(request: Any) -> bool:
    return not isinstance(request, Command)


def _once_a_read(kind: Kind) -> Make:
    """Uses one datagram of a kind of those that come in one read."""

    def read(self: Any) -> None:
        self.seen = False
        ControllerUnderTest._read(self)

    def incoming(self: Any, data: bytes) -> bytes | None:
        if data[6:7] != bytes([kind]):
            return data
        self.seen, before = True, self.seen
        return None if before else data

    return hooked(seen=False, _read=read, incoming=incoming)


def _sends(kind: type, bend: Callable[[bytes], bytes], when: Callable[[Any], bool] = lambda _: True) -> Make:
    """Sends datagrams with a ``kind`` bent, their CRC right."""

    def outgoing(self: Any, data: bytes) -> list[bytes]:
        return [bend(data) if isinstance(decode(data).message, kind) and when(self) else data]

    return hooked(outgoing=outgoing)


def _byte(at: int, value: int) -> Callable[[bytes], bytes]:
    return lambda data: with_number(data, at, "B", value)


def _numbered(when: str, by: int) -> Make:
    """The number behind a kind of message goes on by another step."""
    return edited((C, NUMBER, f"self.next_sequence = number + (1 + {by} if {when} else 1)"))


def _per(key: str) -> Make:
    """Rations refusals by a key."""
    return edited(
        (
            S,
            RATION,
            f"at = self.__dict__.setdefault('_at', {{}})\n        if {key} in at and now_ns - at[{key}] < REFUSAL_INTERVAL_NS:\n            return\n        at[{key}] = now_ns",
        )
    )


MOVING_JOINTS = range(6)
# fmt: off
CLASSES: dict[str, tuple[tuple[str, int, Make], ...]] = {
    "halves of long numbers": (
        ("a nonce by its low half", 256, edited((F, OF, "not (hello.client_nonce ^ self.welcome.client_nonce) & 0xFFFFFFFF"))),
        ("a nonce by its high half", 256, edited((F, OF, "hello.client_nonce >> 32 == self.welcome.client_nonce >> 32"))),
        ("an old nonce but for bit 40", 256, edited((S, "hello.client_nonce in self._past_nonces", "any(not (hello.client_nonce ^ each) & ~(1 << 40) for each in self._past_nonces)"))),
        ("a session but for bit 63", 217, edited((S, "each.channel.session == number", "not (each.channel.session ^ number) & ~(1 << 63)"))),
        ("a session by its low half", 217, edited((S, "each.channel.session == number", "not (each.channel.session ^ number) & 0xFFFFFFFF"))),
        ("answers by an id without bit 50", 434, edited((L, "self._answered.get(command_id)", "self._answered.get(command_id, self._answered.get(command_id & ~(1 << 50)))"))),
        ("OVERTAKEN names half an id", 434, edited((L, "overtaken(command_id, self._newest_id)", "overtaken(command_id, self._newest_id & 0xFFFFFFFF)"))),
        ("motion_id through a float", 257, _shows(motion_id=lambda s, _: int(float(s.motion_id)))),
        ("motion_id without its sign bit", 257, _shows(motion_id=lambda s, _: s.motion_id & 2**63 - 1)),
        ("a heartbeat's time in 56 bits", 422, edited((S, "HeartbeatReply(message.sent_ns,", "HeartbeatReply(message.sent_ns & 2**56 - 1,"))),
        ("stream id + 2^32", 598, follows(lambda m, s: {"stream_id": s.stream_id if not (m.stream_id ^ s.stream_id) & 0xFFFFFFFF else m.stream_id})),
        ("stream id by its high half", 598, follows(lambda m, s: {"stream_id": s.stream_id if m.stream_id >> 32 == s.stream_id >> 32 else m.stream_id})),
        ("a stream's number in 24 bits", 585, follows(lambda m, s: {"number": s.number & ~0xFFFFFF | m.number & 0xFFFFFF})),
        ("the age of a measurement in 32 bits", 599, edited((S, "max(header.sent_ns - message.time_ns, 0)", "max(header.sent_ns - message.time_ns, 0) & 0xFFFFFFFF"))),
        ("grants bit 5", 136, edited((F, "hello.capabilities & self._capabilities", "hello.capabilities & (self._capabilities | 32)"))),
    ),
    "edges of what is accepted": (
        ("0.5 s refused", 561, other_settings("motion.duration_min_s=0.500000001", BAD_DURATION=named_one_of((0.500000001, 0.5)))),
        ("0.4996 s accepted", 561, other_settings("motion.duration_min_s=0.4996", BAD_DURATION=named_one_of((0.4996, 0.5)))),
        ("300.0001 s accepted", 561, other_settings("motion.duration_max_s=300.0001", BAD_DURATION=named_one_of((300.0001, 300.0)))),
        ("-0 s is too short", 439, takes(ReferencePose, lambda r: r._replace(duration_s=-1.0) if math.copysign(1.0, r.duration_s) < 0.0 else r)),
        ("a dwell of -0 is negative", 439, takes(ReferencePath, lambda r: r._replace(dwell_s=-1.0) if str(r.dwell_s) == "-0.0" else r)),
        ("a dwell just below 0 is 0", 562, takes(ReferencePath, lambda r: r._replace(dwell_s=0.0) if -1e-9 < r.dwell_s < 0.0 else r)),
        ("a segment of the least time is too short", 562, takes(ReferencePath, lambda r: r._replace(segment_s=0.1) if r.segment_s == 0.5 else r)),
        ("a first pose a millimetre too far", 564, other_settings("motion.first_point_distance_m=3.001", TOO_FAR=named_always(3.0))),
        ("a workspace a millimetre deeper", 565, reconfigured(lambda: lower_floor(-1e-3), OUTSIDE_WORKSPACE=named_always(-1.0))),
        ("a streamed distance of 0.501 m", 581, other_settings("streaming.distance_m=0.501", TOO_FAR=named_one_of((0.501, 0.5)))),
        ("a twist a thousandth too fast", 583, other_settings("streaming.speed_m_s=0.25025", TOO_FAST=lambda x: x / 1.001 if x < 0.116 else x)),
        ("a norm off by 0.00101", 441, takes(ReferencePose, lambda r: r._replace(X_BT_ref=r.X_BT_ref._replace(q_wxyz=tuple(c * 0.9999 for c in r.X_BT_ref.q_wxyz))))),
    ),
    "one float of one field": (
        ("a subnormal in one twist", 546, follows(lambda m, _: {"twist_ref": tuple(_flushed(v) if k == 3 else v for k, v in enumerate(m.twist_ref))})),
        ("NaN in one streamed quaternion", 546, follows(lambda m, _: {"X_BT_ref": _place(m.X_BT_ref, 6, lambda v: v if math.isfinite(v) else 0.5)})),
        ("NaN in a late waypoint", 440, takes(ReferencePath, lambda r: r._replace(waypoints=(*r.waypoints[:13], *(r.waypoints[0] for _ in r.waypoints[13:14]), *r.waypoints[14:])))),
        ("a subnormal dwell", 440, takes(ReferencePath, lambda r: r._replace(dwell_s=_flushed(r.dwell_s)))),
        ("the greatest subnormal in y", 521, takes(ReferencePose, lambda r: r._replace(X_BT_ref=_place(r.X_BT_ref, 1, lambda v: v if abs(v) < 1e-309 else _flushed(v) if abs(v) < 1.0 else v)))),
        ("negative infinity for a default time", 521, takes(ReferencePose, lambda r: r._replace(duration_s=0.0 if r.duration_s == -math.inf else r.duration_s))),
        ("the least normal is none", 439, takes(ReferencePose, lambda r: r._replace(duration_s=math.nan if 0.0 < abs(r.duration_s) < 1e-300 else r.duration_s))),
    ),
    "a peer's clock from any start": (
        ("drops a clock above 2^63", 316, _hears(lambda d: len(d) > 40 and _sent_ns(d) >> 63 == 1)),
        ("drops a time of 0", 316, _hears(lambda d: len(d) > 40 and _sent_ns(d) == 0)),
        ("ages in 53 bits", 316, edited((C, "transit = now_ns - sent_ns", "transit = now_ns - (sent_ns & (1 << 53) - 1)"))),
        ("restarts by a signed time", 316, edited((S, "header.sent_ns < session.hello_sent_ns", "header.sent_ns ^ 1 << 63 < session.hello_sent_ns ^ 1 << 63"))),
        ("ages in 40 bits", 316, edited((C, "transit = now_ns - sent_ns", "transit = now_ns - (sent_ns & (1 << 40) - 1)"))),
    ),
    "sign of one joint": (
        *((f"the valve of joint {j + 1}", 595, _negated(("valves",), j)) for j in MOVING_JOINTS),
        *((f"q_meas of joint {j + 1}", 595, _negated(("q_meas",), j)) for j in MOVING_JOINTS),
        *((f"joint {j + 1} whole", 595, _negated(("q_meas", "q_cmd", "valves"), j)) for j in range(3)),
        ("y of X_BT", 595, _shows(X_BT=lambda s, _: _place(s.X_BT, 1, lambda v: -v))),
    ),
    "counts of the scan": (
        ("leaps by 100 at ENABLE", 899, _counts(lambda self, s: 100 * _entered(self, s, GroupState.STANDBY))),
        ("stands in ERROR_STOP", 895, _counts(lambda _, s: -(s.group_state is GroupState.ERROR_STOP))),
        ("counts twice in motion", 899, _counts(lambda _, s: s.group_state is GroupState.MOVING)),
        ("goes back by one at an emergency", 895, _counts(lambda self, s: -_entered(self, s, GroupState.ERROR_STOP))),
        ("leaps by 6 when it stops", 899, _counts(lambda self, s: 6 * _entered(self, s, GroupState.STOPPING))),
    ),
    "order across kinds": (
        ("commands first", 425, _ordered(lambda taken: sorted(taken, key=_is_reference))),
        ("references first", 425, _ordered(lambda taken: sorted(taken, key=lambda r: not _is_reference(r)))),
        ("the last first", 424, _ordered(lambda taken: taken[::-1])),
        ("stops keep no order", 427, _ordered(lambda taken: sorted(taken, key=lambda r: getattr(r, "code", 99)))),
        (
            "a command overtakes references",
            426,
            edited(
                (
                    "inbox",
                    "            waiting = [*commands, request]",
                    "            if isinstance(request, Command):\n                gone += [each for each in commands if not isinstance(each, Command)]\n                commands = [each for each in commands if isinstance(each, Command)]\n            waiting = [*commands, request]",
                )
            ),
        ),
        (
            "no path overtakes",
            424,
            edited(
                (
                    S,
                    "            self.acknowledge(Acknowledgement(*request), now_ns)\n            return []",
                    "            self.acknowledge(Acknowledgement(*request), now_ns)\n            return [RequestReceived(__import__('protocol.reference_messages').reference_messages.ReferencePose(request.command_id, __import__('protocol.pose').pose.IDENTITY, 0.0))]",
                )
            ),
        ),
    ),
    "many peers": (
        ("rations by source", 223, _per("source")),
        ("rations by reason", 223, _per("reason")),
        ("rations by session", 223, _per("session")),
        (
            "counts what it drops",
            247,
            edited(
                (
                    S,
                    "        return self._tally.drop(cause, detail)",
                    "        self._refused_at_ns = self._refused_at_ns if cause in ('session.unknown', 'session.wrong_arm', 'session.occupied') and not detail.startswith('session 1234') else getattr(self, '_now', None)\n        return self._tally.drop(cause, detail)",
                ),
                (S, "        events = self.tick(now_ns)\n", "        events, self._now = self.tick(now_ns), now_ns\n"),
            ),
        ),
        (
            "keeps a grant of each source",
            234,
            edited(
                (S, "        self._unconfirmed = self._granted(", "        self.__dict__.setdefault('_all', {})[source] = self._unconfirmed = self._granted("),
                (
                    S,
                    "        sessions = (self._session, self._unconfirmed)\n",
                    "        for each in self.__dict__.get('_all', {}).values():\n            if each.channel.session == number and each is not self._session:\n                self._unconfirmed = each\n        sessions = (self._session, self._unconfirmed)\n",
                ),
            ),
        ),
    ),
    "grants": (
        ("BYE in a grant is ignored", 258, edited((S, TAKEN, "                return []"))),
        ("BYE in a grant ends the session in use", 258, edited((S, TAKEN, "                self._unconfirmed = None\n                return self.close(now_ns)"))),
        (
            "HELLO again changes the period",
            208,
            edited(
                (
                    S,
                    AGAIN,
                    "                if dropped is None:\n                    each.welcome = each.welcome._replace(state_period_ms=hello.state_period_ms)\n                    self._post(each, each.welcome, now_ns)",
                )
            ),
        ),
        ("HELLO again changes the period in silence", 208, edited((S, AGAIN, AGAIN + "\n                    each.welcome = each.welcome._replace(state_period_ms=hello.state_period_ms)"))),
        ("HELLO again is judged by its arm", 208, edited((S, "if each and each.is_of(hello, source):", "if each and each.is_of(hello, source) and hello.arm_hash in (ANY_ARM, self._arm_hash):"))),
        ("HELLO again prolongs a grant", 259, edited((S, AGAIN, AGAIN + "\n                    each.greeted_ns = now_ns"))),
        (
            "HELLO of another arm takes a grant back",
            260,
            edited((S, "            self._refuse(Reason.WRONG_ARM, 0, source, now_ns)", "            self._unconfirmed = None\n            self._refuse(Reason.WRONG_ARM, 0, source, now_ns)")),
        ),
    ),
    "several in one read": (
        ("one reply for three heartbeats", 422, _once_a_read(Kind.HEARTBEAT)),
        ("one command a read", 401, _once_a_read(Kind.COMMAND)),
        ("one pose a read", 401, _once_a_read(Kind.REFERENCE_POSE)),
        ("one HELLO a read", 208, _once_a_read(Kind.HELLO)),
    ),
    "numbering": (
        ("WELCOME's number is repeated", 894, _numbered("type(message).__name__ == 'Welcome'", -1)),
        ("a number is left out behind BYE", 894, _numbered("type(message).__name__ == 'StreamRefused'", 1)),
        ("the number of a refusal is repeated", 894, _numbered("getattr(message, 'reason', 0) == 24", -1)),
        ("a number is left out behind each hundredth", 894, _numbered("number % 100 == 99", 1)),
    ),
    "reserved bits": (
        ("a flag of STATE in an emergency", 896, _shows(flags=lambda s, _: s.flags | 128 * (s.group_state is GroupState.ERROR_STOP))),
        ("a flag of STATE in motion", 899, _shows(flags=lambda s, _: s.flags | 16 * (s.group_state is GroupState.MOVING))),
        ("a flag of a reply's header", 896, _sends(HeartbeatReply, _byte(8, 9))),
        ("padding of BYE", 891, _sends(Bye, _byte(47, 1))),
        ("padding of WELCOME", 891, _sends(Welcome, _byte(84, 255))),
        ("the spare byte of a refusal", 891, _sends(StreamRefused, _byte(7, 1))),
        ("a capability of no table", 136, edited((F, "hello.capabilities & self._capabilities", "hello.capabilities & (self._capabilities | 1 << 33)"))),
    ),
}
# fmt: on
MUTANTS = tuple(
    BrokenController(f"{kind}: {name}", "", make, case=case)
    for kind, rows in CLASSES.items()
    for name, case, make in rows
)
