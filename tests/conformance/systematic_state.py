"""For every field of STATE controllers that show it stale, frozen, as nothing, or in its neighbour's place.

Clauses 7.5 to 7.8: what lasts too short or too long, and what a lost link does in each mode, likewise.
"""

from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from controller.core.group_states import TRANSITIONS, Stimulus
from controller.core.scan_types import NO_FAULT
from controller.core.supervision import Fault
from protocol.axes_group import Mode
from protocol.datagram_layout import Kind
from protocol.faults import FaultCode, GroupState, Severity
from protocol.reference_messages import (
    FLAG_EMERGENCY_LATCHED,
    FLAG_PLANT_LINK_OK,
    FLAG_SETTLED,
    FLAG_STREAMING,
    State,
)
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.mutant_report import BrokenController

STALE_SCANS = 40
KIND = 6
Shown = Callable[[deque[State]], dict[str, Any]]


class ShowsOtherwise(ControllerUnderTest):
    """Shows fields of STATE otherwise; ``fields`` gets the STATEs of the last 200 ms, the newest last."""

    def __init__(self, fields: Shown) -> None:
        super().__init__()
        self._fields = fields
        self._before: deque[State] = deque(maxlen=STALE_SCANS + 1)

    def shown(self, state: State) -> State:
        self._before.append(state)
        return state._replace(**self._fields(self._before))


class _Frozen:
    """The field as it was first."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._first: Any = None

    def __call__(self, states: deque[State]) -> dict[str, Any]:
        if self._first is None:
            self._first = getattr(states[-1], self._name)
        return {self._name: self._first}


def _stale(name: str, states: deque[State]) -> dict[str, Any]:
    return {name: getattr(states[0], name)}


def _swapped(a: str, b: str, states: deque[State]) -> dict[str, Any]:
    of_a, of_b = getattr(states[-1], a), getattr(states[-1], b)
    if isinstance(of_a, tuple):
        return {a: of_b, b: of_a}
    return {a: type(of_a)(of_b), b: type(of_b)(of_a)}


def _always(value: dict[str, Any], states: deque[State]) -> dict[str, Any]:
    return value


def _flag(bit: int, value: bool, states: deque[State]) -> dict[str, Any]:
    return {"flags": states[-1].flags | bit if value else states[-1].flags & ~bit}


ZERO = (0.0,) * 6
NO_OFFSET = "a count from any start has no right value"
CANNOT_FAIL = "a client cannot make the fieldbus or a scan fail"
MAY_BE_SO = "a value that a sound controller may show"
# Clause, the case that is meant to catch it, or why none can.
Row = tuple[str, int, str]
STALE: dict[str, Row] = {
    "time_ns": ("7.7", 511, ""),
    "cycle": ("7.7", 0, NO_OFFSET),
    "group_state": ("7.2", 811, ""),
    "fault": ("7.6", 514, ""),
    "severity": ("7.6", 514, ""),
    "flags": ("7.7", 571, ""),
    "motion_id": ("7.8", 516, ""),
    "motion_done": ("7.8", 516, ""),
    "segment": ("6.8", 557, ""),
    "q_meas": ("7.7", 513, ""),
    "q_cmd": ("7.7", 513, ""),
    "valves": ("7.4", 571, ""),
    "X_BT": ("7.7", 513, ""),
    "X_BT_cmd": ("7.7", 577, ""),
    "supply_bar": ("7.7", 0, MAY_BE_SO),
    "overruns": ("7.7", 0, CANNOT_FAIL),
    "references_lost": ("5.2", 310, ""),
    "references_dropped": ("5.2", 310, ""),
    "plant_exchange_failures": ("7.7", 0, CANNOT_FAIL),
    "stream_number": ("12.3", 586, ""),
}
FROZEN: dict[str, Row] = {
    "time_ns": ("7.7", 413, ""),
    "cycle": ("7.7", 413, ""),
    "group_state": ("7.2", 810, ""),
    "fault": ("7.6", 514, ""),
    "severity": ("7.6", 514, ""),
    "flags": ("7.7", 507, ""),
    "motion_id": ("7.8", 527, ""),
    "motion_done": ("7.8", 527, ""),
    "segment": ("6.8", 557, ""),
    "q_meas": ("7.7", 513, ""),
    "q_cmd": ("7.7", 513, ""),
    "valves": ("7.7", 518, ""),
    "X_BT": ("7.7", 518, ""),
    "X_BT_cmd": ("6.7", 527, ""),
    "references_lost": ("5.2", 310, ""),
    "references_dropped": ("5.2", 310, ""),
    "stream_number": ("12.3", 550, ""),
}
SWAPPED: dict[tuple[str, str], Row] = {
    ("time_ns", "cycle"): ("7.7", 413, ""),
    ("fault", "severity"): ("7.6", 514, ""),
    ("q_meas", "q_cmd"): ("7.7", 518, ""),
    ("q_cmd", "valves"): ("7.7", 513, ""),
    ("X_BT", "X_BT_cmd"): ("6.7", 518, ""),
    ("overruns", "lateness_p50_us"): ("7.7", 0, MAY_BE_SO),
    ("lateness_p50_us", "lateness_p99_us"): ("7.7", 512, ""),
    ("lateness_p99_us", "lateness_max_us"): ("7.7", 512, ""),
    ("references_lost", "references_dropped"): ("5.2", 310, ""),
}
ALWAYS: dict[str, tuple[dict[str, Any], Row]] = {
    "no valve": ({"valves": ZERO}, ("7.7", 518, "")),
    "done": ({"motion_done": True}, ("7.8", 516, "")),
    "no supply": ({"supply_bar": 0.0}, ("7.7", 512, "")),
    "segment 1": ({"segment": 1}, ("6.8", 557, "")),
    "no severity": ({"severity": Severity.NONE}, ("7.6", 514, "")),
    "a stop": ({"severity": Severity.STOP}, ("7.6", 514, "")),
    "standby": ({"group_state": GroupState.STANDBY}, ("7.2", 811, "")),
}
FLAGS: dict[tuple[int, bool], tuple[str, Row]] = {
    (FLAG_PLANT_LINK_OK, False): ("no plant link", ("7.7", 518, "")),
    (FLAG_PLANT_LINK_OK, True): ("a plant link", ("7.7", 0, CANNOT_FAIL)),
    (FLAG_EMERGENCY_LATCHED, False): ("no emergency", ("7.4", 507, "")),
    (FLAG_EMERGENCY_LATCHED, True): ("an emergency", ("7.4", 509, "")),
    (FLAG_SETTLED, False): ("not settled", ("7.8", 517, "")),
    (FLAG_SETTLED, True): ("settled", ("7.8", 516, "")),
    (FLAG_STREAMING, False): ("no stream", ("12.2", 544, "")),
    (FLAG_STREAMING, True): ("a stream", ("7.7", 821, "")),
}


def _broken(name: str, row: Row, make: Callable[[], ControllerUnderTest]) -> BrokenController:
    clause, case, unseen = row
    return BrokenController(name, clause, make, unseen=unseen, case=case)


def _of_fields() -> Iterator[BrokenController]:
    def made(shown: Callable[[], Shown]) -> Callable[[], ControllerUnderTest]:
        return lambda: ShowsOtherwise(shown())

    for name, row in STALE.items():
        yield _broken(f"{name} 200 ms old", row, made(lambda name=name: partial(_stale, name)))
    for name, row in FROZEN.items():
        yield _broken(f"{name} frozen", row, made(lambda name=name: _Frozen(name)))
    for pair, row in SWAPPED.items():
        yield _broken(f"{' and '.join(pair)} swapped", row, made(lambda pair=pair: partial(_swapped, *pair)))
    for name, (value, row) in ALWAYS.items():
        yield _broken(f"always {name}", row, made(lambda value=value: partial(_always, value)))
    for (bit, on), (name, row) in FLAGS.items():
        yield _broken(f"flag: always {name}", row, made(lambda bit=bit, on=on: partial(_flag, bit, on)))


class NegatedValves(ControllerUnderTest):
    """Shows the valves with the other sign."""

    def shown(self, state: State) -> State:
        a, b, c, d, e, f = (-valve for valve in state.valves)
        return state._replace(valves=(a, b, c, d, e, f))


class CommandStays(ControllerUnderTest):
    """Shows the last command of a drive for as long as nothing is driven."""

    live: State | None = None

    def shown(self, state: State) -> State:
        held = state.group_state in (GroupState.DISABLED, GroupState.ERROR_STOP) and not any(state.valves)
        if not held or self.live is None:
            self.live = state
            return state
        return state._replace(q_cmd=self.live.q_cmd, X_BT_cmd=self.live.X_BT_cmd)


class FollowsOnlyInJoints(CommandStays):
    """Of what follows the measurement forgets the pose."""

    def shown(self, state: State) -> State:
        return super().shown(state)._replace(q_cmd=state.q_cmd)


class SlowerStates(ControllerUnderTest):
    """Sends STATE at a share of the granted rate, from ``after_s`` on."""

    def __init__(self, factor: float, after_s: float = 0.0) -> None:
        super().__init__()
        self._factor, self._after_ns = factor, int(after_s * 1e9)
        self._granted: dict[int, tuple[int, int]] = {}

    def _scan(self) -> None:
        session = self.server._session
        if session is not None:
            key = session.channel.session
            begun_ns, period_ms = self._granted.setdefault(
                key, (self._clock_ns(), session.welcome.state_period_ms)
            )
            if period_ms and self._clock_ns() - begun_ns > self._after_ns:
                slowed = max(round(period_ms * self._factor), 1)
                session.welcome = session.welcome._replace(state_period_ms=slowed)
        super()._scan()


class FaultEndsWithSession(ControllerUnderTest):
    """A new session clears fault and severity."""

    def incoming(self, data: bytes) -> bytes | None:
        if len(data) > KIND and data[KIND] == Kind.HELLO:
            self.bench.state = self.bench.state._replace(fault=NO_FAULT, severity=Severity.NONE)
        return data


class ChangesWhatIsLatched(ControllerUnderTest):
    """Latches otherwise than 7.6: ``latched`` gets fault and severity of before and after a scan."""

    def __init__(self, latched: Callable[[Any, Any], dict[str, Any]]) -> None:
        super().__init__()
        self._latched = latched

    def _scan(self) -> None:
        before = self.bench.state
        super()._scan()
        self.bench.state = self.bench.state._replace(**self._latched(before, self.bench.state))


def _newest_fault(before: Any, after: Any) -> dict[str, Any]:
    emergency = after.mode is Mode.EMERGENCY and before.mode is not Mode.EMERGENCY
    return {"fault": Fault(FaultCode.EMERGENCY_STOP, 0.0, 0.0)} if emergency else {}


def _first_severity(before: Any, after: Any) -> dict[str, Any]:
    kept = before.severity is not Severity.NONE and after.severity > before.severity
    return {"severity": before.severity} if kept else {}


def _cleared_by_release(before: Any, after: Any) -> dict[str, Any]:
    released = before.mode is Mode.EMERGENCY and after.mode is Mode.ERROR_HELD
    return {"fault": NO_FAULT, "severity": Severity.NONE} if released else {}


def _severity_kept(before: Any, after: Any) -> dict[str, Any]:
    reset = before.mode is Mode.ERROR_HELD and after.mode is Mode.DISABLED
    return {"severity": before.severity} if reset else {}


def _fault_kept(before: Any, after: Any) -> dict[str, Any]:
    reset = before.mode is Mode.ERROR_HELD and after.mode is Mode.DISABLED
    return {"fault": before.fault} if reset else {}


class OfAnotherLink(ControllerUnderTest):
    """Reacts otherwise to a lost link in one mode."""

    def __init__(self, mode: Mode, then: Mode) -> None:
        super().__init__()
        self._cell, self._then = (mode, Stimulus.UNATTENDED), then

    def _scan(self) -> None:
        right = TRANSITIONS[self._cell]
        TRANSITIONS[self._cell] = right._replace(mode=self._then)
        before = self.bench.state.mode
        try:
            super()._scan()
        finally:
            TRANSITIONS[self._cell] = right
        reacted = before is Mode.MOVING and self.bench.state.mode is Mode.ERROR_RAMP
        if reacted and self._cell[0] is Mode.MOVING:  # the scan knows this one by itself
            self.bench.state = self.bench.state._replace(mode=self._then)


class StopsTakeNoMotion(ControllerUnderTest):
    """Calls a motion that was stopped done."""

    def shown(self, state: State) -> State:
        return state._replace(motion_done=state.group_state is GroupState.STANDBY and state.motion_id != 0)


class RefusalUndoesDone(ControllerUnderTest):
    """Takes motion_done back 100 ms after it was set."""

    since = 0

    def shown(self, state: State) -> State:
        self.since = self.since + 1 if state.motion_done else 0
        return state._replace(motion_done=0 < self.since < 20)


def _others() -> Iterator[BrokenController]:
    for make, clause, case in (
        (NegatedValves, "7.7", 518),
        (CommandStays, "7.7", 513),
        (FollowsOnlyInJoints, "7.7", 513),
        (FaultEndsWithSession, "7.6", 514),
        (FaultEndsWithSession, "7.4", 515),
        (StopsTakeNoMotion, "7.8", 517),
        (RefusalUndoesDone, "7.8", 516),
    ):
        yield BrokenController(make.__name__, clause, make, case=case)
    for what in (_newest_fault, _first_severity, _cleared_by_release, _severity_kept, _fault_kept):
        name = f"latched:{what.__name__.replace('_', ' ')}"
        yield BrokenController(name, "7.6", partial(ChangesWhatIsLatched, what), case=514)
    for factor, after_s in ((1.25, 0.0), (2.0, 0.0), (2.0, 1.0), (0.5, 0.0)):
        name = f"STATE at {1 / factor:g} of its rate, from {after_s:g} s on"
        yield BrokenController(name, "7.7", partial(SlowerStates, factor, after_s), case=411)
    for mode, then, case in (
        (Mode.STANDBY, Mode.STANDBY, 540),
        (Mode.STANDBY, Mode.ERROR_HELD, 540),
        (Mode.MOVING, Mode.STOPPING, 529),
        (Mode.MOVING, Mode.DISABLING, 529),
        (Mode.MOVING, Mode.ERROR_HELD, 860),
        (Mode.STOPPING, Mode.STOPPING, 539),
        (Mode.DISABLING, Mode.ERROR_RAMP, 519),
    ):
        name = f"a lost link in {mode.name} leads to {then.name}"
        yield BrokenController(name, "7.5", partial(OfAnotherLink, mode, then), case=case)


MUTANTS = (*_of_fields(), *_others())
