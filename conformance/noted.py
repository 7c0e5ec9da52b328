"""What a run notes of its controller, over all its cases: where its arm stood, and what it must never send.

Everything that comes is looked at, whatever it answers: a fault that shows in one mode, or in the answer to
one kind of datagram, is noted though no case asks for it there. ``datagrams_sent`` judges what was noted.
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
    UnusableRequest,
    Welcome,
)

TABLED = CAPABILITY_PATHS | CAPABILITY_STREAMING | CAPABILITY_AUTHENTICATION | CAPABILITY_VALVE_TRIALS
_STATE_FLAGS = FLAG_PLANT_LINK_OK | FLAG_EMERGENCY_LATCHED | FLAG_SETTLED | FLAG_STREAMING
_HEADER_FLAGS = FLAG_ECHO_VALID | FLAG_AUTHENTICATED
_NUMBERS = 1 << 32
# Scans that a clock's grain may show too many; what skipped ones may lack of their time, at once and in all.
AHEAD_SCANS, SKIPPED_MS, SKIPPED = 3, 50.0, 0.3
_MS = 1e6
# A session ends with these; the other reasons of BYE answer those who have none.
ENDINGS = (Reason.ACCEPTED, Reason.PEER_RESTARTED, Reason.LINK_TIMEOUT, Reason.SHUTDOWN)


class Always(Enum):
    """What holds of all that a controller sends: the clause, and what it says."""

    UNCLEAN = "1.8", "spare and padding bytes are zero"
    CLOCK_BACK = "1.7", "the time of sending does not go back"
    UNTABLED = "4.3", "no capability is granted that is in no table"
    MISNUMBERED = "5.1", "numbers rise one by one, from WELCOME on"
    MISCOUNTED = "7.7", "cycle goes on by one with every scan"
    RESERVED = "9.1", "no flag is set that is in no table"
    UNWHOLE = "7.7", "STATE is whole: finite numbers, unit quaternions, valves in range"


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
        self.breaches: dict[Always, str] = {}
        self.case = 0
        self.toured = False
        self._newest: dict[int, int] = {}
        self._sent_ns: dict[int, int] = {}
        self._cycle_ns: dict[int, int] = {}
        self._states: dict[int, State] = {}
        self._leads: dict[int, tuple[int, int, State]] = {}

    def look(self, data: bytes, datagram: Datagram, *, whole: bool) -> None:
        """Notes a datagram that came; ``whole``: none can have been lost on its way here."""
        (session, number, sent_ns, _, flags, _), message = datagram
        kind = Kind(data[6])
        self._note(not any(data[at] for at in _UNUSED[kind]), Always.UNCLEAN, kind, data.hex())
        self._note(not flags & ~_HEADER_FLAGS, Always.RESERVED, kind, f"header flags {flags:#06x}")
        if isinstance(message, Bye) and message.reason not in ENDINGS:
            return
        first = session not in self._newest
        step = (number - self._newest.get(session, number - 1)) % _NUMBERS
        good = isinstance(message, Welcome) or not first
        self._note(good, Always.MISNUMBERED, kind, "the first of its session, before WELCOME")
        good = step == 1 if whole else 0 < step < _NUMBERS // 2
        self._note(good, Always.MISNUMBERED, kind, f"a step of {step} from the number before")
        self._newest[session] = number
        back_ns = self._sent_ns.get(session, 0) - sent_ns
        self._note(back_ns <= 0, Always.CLOCK_BACK, kind, f"sent_ns goes back by {back_ns}")
        self._sent_ns[session] = sent_ns
        if isinstance(message, Welcome):
            self._cycle_ns[session] = message.cycle_ns
            others = message.capabilities & ~TABLED
            self._note(not others, Always.UNTABLED, kind, f"capabilities {others:#x}, which are in no table")
        elif isinstance(message, State):
            self._look_at_state(session, message)

    def _look_at_state(self, session: int, state: State) -> None:
        others = state.flags & ~_STATE_FLAGS
        self._note(not others, Always.RESERVED, Kind.STATE, f"flags {others:#x}, which are in no table")
        numbers = (
            *state.q_meas,
            *state.q_cmd,
            *state.valves,
            state.supply_bar,
            *state.X_BT.p_m,
            *state.X_BT_cmd.p_m,
        )
        norms = [pose.quaternion_norm() for pose in (state.X_BT, state.X_BT_cmd)]
        good = all(map(math.isfinite, numbers)) and all(abs(norm - 1.0) < 1e-6 for norm in norms)
        good &= all(-1.0 <= valve <= 1.0 for valve in state.valves)
        self._note(good, Always.UNWHOLE, Kind.STATE, f"valves {state.valves}, norms {norms}")
        before, cycle_ns = self._states.get(session, state), self._cycle_ns.get(session, 0)
        self._states[session] = state
        lead_ns = state.cycle * cycle_ns - state.time_ns
        least, most, first = self._leads.get(session, (lead_ns, lead_ns, state))
        self._leads[session] = min(least, lead_ns), max(most, lead_ns), first
        scans, passed_ns = state.cycle - before.cycle, state.time_ns - before.time_ns
        skipped_ns = SKIPPED_MS * _MS + SKIPPED * (state.time_ns - first.time_ns)
        skipped_ns += cycle_ns * ((state.overruns - first.overruns) % _NUMBERS)  # it says so itself
        good = before is state or (scans > 0 and passed_ns > 0)
        good &= lead_ns - least <= AHEAD_SCANS * cycle_ns and most - lead_ns < skipped_ns
        what = f"cycle goes on by {scans} within {passed_ns / _MS:.1f} ms, to {state.group_state.name}"
        self._note(good, Always.MISCOUNTED, Kind.STATE, what)

    def _note(self, good: bool, what: Always, kind: Kind, how: str) -> None:
        if not good:
            self.breaches.setdefault(what, f"{kind.name} in case {self.case}: {how}")


def went_on(message: Message | UnusableRequest, before: State | None) -> Message | UnusableRequest:
    """``message``, if it is a STATE, as it goes on from the one before.

    Counts that wrap at 2^32 go on above it, and of a quaternion and its negative, which are the same (1.5),
    it is the one nearer to the one before.
    """
    if not isinstance(message, State) or before is None:
        return message
    return message._replace(
        references_lost=_on(message.references_lost, before.references_lost),
        references_dropped=_on(message.references_dropped, before.references_dropped),
        X_BT=_nearer(message.X_BT, before.X_BT),
        X_BT_cmd=_nearer(message.X_BT_cmd, before.X_BT_cmd),
    )


def _on(count: int, before: int) -> int:
    return before + (count - before + _NUMBERS // 2) % _NUMBERS - _NUMBERS // 2


def _nearer(pose: Pose, before: Pose) -> Pose:
    same = math.fsum(a * b for a, b in zip(pose.q_wxyz, before.q_wxyz, strict=True)) >= 0.0
    w, x, y, z = pose.q_wxyz
    return pose if same else pose._replace(q_wxyz=(-w, -x, -y, -z))
