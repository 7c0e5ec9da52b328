"""What a run notes of its controller, over all its cases: where its arm stood, and what it must never send.

Everything that comes is looked at, whatever it answers: a fault that shows in one mode, or in the answer to
one kind of datagram, is noted though no case asks for it there. ``classes.whole_run`` judges what was noted.
"""

import math
from enum import Enum

from protocol.datagram import Datagram
from protocol.datagram_layout import (
    FLAG_AUTHENTICATED,
    FLAG_ECHO_VALID,
    HEADER,
    HEADER_BYTES,
    PAYLOADS,
    Kind,
    offsets,
)
from protocol.faults import Reason
from protocol.pose import Pose
from protocol.reference_messages import (
    CAPABILITY_AUTHENTICATION,
    CAPABILITY_PATHS,
    CAPABILITY_STREAMING,
    CAPABILITY_VALVE_TRIALS,
    FLAG_EMERGENCY_LATCHED,
    FLAG_PLANT_LINK_OK,
    FLAG_SETTLED,
    FLAG_STREAMING,
    Bye,
    Message,
    State,
    Welcome,
)

TABLED = CAPABILITY_PATHS | CAPABILITY_STREAMING | CAPABILITY_AUTHENTICATION | CAPABILITY_VALVE_TRIALS
_STATE_FLAGS = FLAG_PLANT_LINK_OK | FLAG_EMERGENCY_LATCHED | FLAG_SETTLED | FLAG_STREAMING
_HEADER_FLAGS = FLAG_ECHO_VALID | FLAG_AUTHENTICATED
_NUMBERS = 1 << 32
# Scans that a clock's grain may show too many; what scans that were skipped may lack of their time.
AHEAD_SCANS, SKIPPED_MS = 3, 50.0
_MS = 1e6
# A session ends with these; the other reasons of BYE answer those who have none.
ENDINGS = (Reason.ACCEPTED, Reason.PEER_RESTARTED, Reason.LINK_TIMEOUT, Reason.SHUTDOWN)


class Never(Enum):
    """What a controller never sends; the value is the clause."""

    UNCLEAN = "1.8"
    CLOCK_BACK = "1.7"
    UNTABLED = "4.3"
    MISNUMBERED = "5.1"
    MISCOUNTED = "7.7"
    RESERVED = "9.1"


def _unused(kind: Kind) -> list[int]:
    """Where its spare and padding bytes lie."""
    rows = [*zip(HEADER, offsets(HEADER), strict=True)]
    rows += [(f, HEADER_BYTES + at) for f, at in zip(PAYLOADS[kind], offsets(PAYLOADS[kind]), strict=True)]
    return [at + n for f, at in rows if f.code == "x" or f.name == "spare" for n in range(f.size)]


_UNUSED = {kind: _unused(kind) for kind in Kind}


class Noted:
    """``home``: the pose that the arm had when it was first enabled. ``breaches``: the first of each."""

    def __init__(self) -> None:
        self.home: Pose | None = None
        self.breaches: dict[Never, str] = {}
        self.case = 0
        self._newest: dict[int, int] = {}
        self._sent_ns: dict[int, int] = {}
        self._cycle_ns: dict[int, int] = {}
        self._states: dict[int, State] = {}

    def look(self, data: bytes, datagram: Datagram, *, whole: bool) -> None:
        """Notes a datagram that came; ``whole``: none can have been lost on its way here."""
        (session, number, sent_ns, _, flags, _), message = datagram
        kind = Kind(data[6])
        self._note(not any(data[at] for at in _UNUSED[kind]), Never.UNCLEAN, kind, data.hex())
        self._note(not flags & ~_HEADER_FLAGS, Never.RESERVED, kind, f"header flags {flags:#06x}")
        if isinstance(message, Bye) and message.reason not in ENDINGS:
            return
        step = (number - self._newest.get(session, number - 1)) % _NUMBERS
        good = step == 1 if whole else 0 < step < _NUMBERS // 2
        self._note(good, Never.MISNUMBERED, kind, f"a step of {step} from the number before")
        self._newest[session] = number
        back_ns = self._sent_ns.get(session, 0) - sent_ns
        self._note(back_ns <= 0, Never.CLOCK_BACK, kind, f"sent_ns goes back by {back_ns}")
        self._sent_ns[session] = sent_ns
        if isinstance(message, Welcome):
            self._cycle_ns[session] = message.cycle_ns
            others = message.capabilities & ~TABLED
            self._note(not others, Never.UNTABLED, kind, f"capabilities {others:#x}, which are in no table")
        elif isinstance(message, State):
            self._look_at_state(session, message)

    def _look_at_state(self, session: int, state: State) -> None:
        others = state.flags & ~_STATE_FLAGS
        self._note(not others, Never.RESERVED, Kind.STATE, f"flags {others:#x}, which are in no table")
        before, cycle_ns = self._states.get(session), self._cycle_ns.get(session)
        self._states[session] = state
        if before is None or cycle_ns is None:
            return
        scans, passed_ns = state.cycle - before.cycle, state.time_ns - before.time_ns
        ahead_ns = scans * cycle_ns - passed_ns
        good = scans > 0 and passed_ns > 0 and -SKIPPED_MS * _MS < ahead_ns <= AHEAD_SCANS * cycle_ns
        what = f"cycle goes on by {scans} within {passed_ns / _MS:.1f} ms, to {state.group_state.name}"
        self._note(good, Never.MISCOUNTED, Kind.STATE, what)

    def _note(self, good: bool, what: Never, kind: Kind, how: str) -> None:
        if not good:
            self.breaches.setdefault(what, f"{kind.name} in case {self.case}: {how}")


def went_on(message: Message, before: State | None) -> Message:
    """``message``, if it is a STATE, as it goes on from the one before.

    Counts that wrap at 2^32 go on above it, and of a quaternion and its negative, which are the same (1.5),
    it is the one nearer to the one before.
    """
    if not isinstance(message, State) or before is None:
        return message
    counts = {
        name: old + (new - old + _NUMBERS // 2) % _NUMBERS - _NUMBERS // 2
        for name in ("references_lost", "references_dropped")
        for new, old in ((getattr(message, name), getattr(before, name)),)
    }
    poses = {name: _nearer(getattr(message, name), getattr(before, name)) for name in ("X_BT", "X_BT_cmd")}
    return message._replace(**counts, **poses)


def _nearer(pose: Pose, before: Pose) -> Pose:
    same = math.fsum(a * b for a, b in zip(pose.q_wxyz, before.q_wxyz, strict=True)) >= 0.0
    w, x, y, z = pose.q_wxyz
    return pose if same else pose._replace(q_wxyz=(-w, -x, -y, -z))
