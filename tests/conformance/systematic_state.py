"""For every field of STATE controllers that show it stale, frozen, as nothing, or in its neighbour's place.

Clauses 7.5 to 7.8: what lasts too short or too long, and what a lost link does in each mode, likewise.
"""

from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any
from unittest.mock import patch

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
from tests.conformance.mutator import BrokenController, Make, hooked

STALE_SCANS = 40
# From the STATEs of the last 200 ms, the newest last, the fields that are shown otherwise.
Shown = Callable[[deque[State]], dict[str, Any]]


def _shows(fields: Shown) -> Make:
    """Makes controllers that show fields of STATE otherwise."""

    def shown(self: Any, state: State) -> State:
        self.states = getattr(self, "states", None) or deque(maxlen=STALE_SCANS + 1)
        self.states.append(state)
        return state._replace(**fields(self.states))

    return hooked(shown=shown)


def _frozen(name: str) -> Make:
    def shown(self: Any, state: State) -> State:
        self.first = getattr(self, "first", getattr(state, name))
        return state._replace(**{name: self.first})

    return hooked(shown=shown)


def _stale(name: str, states: deque[State]) -> dict[str, Any]:
    return {name: getattr(states[0], name)}


def _swapped(a: str, b: str, states: deque[State]) -> dict[str, Any]:
    of_a, of_b = getattr(states[-1], a), getattr(states[-1], b)
    return {a: of_b, b: of_a} if isinstance(of_a, tuple) else {a: type(of_a)(of_b), b: type(of_b)(of_a)}


def _flag(bit: int, value: bool, states: deque[State]) -> dict[str, Any]:
    return {"flags": states[-1].flags | bit if value else states[-1].flags & ~bit}


ZERO = (0.0,) * 6
Row = tuple[str, int]  # clause, and the case that must catch it
STALE: dict[str, Row] = {
    "time_ns": ("7.7", 511),
    "group_state": ("7.2", 811),
    "fault": ("7.6", 514),
    "severity": ("7.6", 514),
    "flags": ("7.7", 571),
    "motion_id": ("7.8", 516),
    "motion_done": ("7.8", 516),
    "segment": ("6.8", 557),
    "q_meas": ("7.7", 513),
    "q_cmd": ("7.7", 513),
    "valves": ("7.4", 571),
    "X_BT": ("7.7", 513),
    "X_BT_cmd": ("7.7", 577),
    "references_lost": ("5.2", 310),
    "references_dropped": ("5.2", 310),
    "stream_number": ("12.3", 586),
}
FROZEN: dict[str, Row] = {
    "time_ns": ("7.7", 895),
    "cycle": ("7.7", 895),
    "group_state": ("7.2", 810),
    "fault": ("7.6", 514),
    "severity": ("7.6", 514),
    "flags": ("7.7", 507),
    "motion_id": ("7.8", 527),
    "motion_done": ("7.8", 527),
    "segment": ("6.8", 557),
    "q_meas": ("7.7", 513),
    "q_cmd": ("7.7", 513),
    "valves": ("7.7", 518),
    "X_BT": ("7.7", 518),
    "X_BT_cmd": ("6.7", 527),
    "references_lost": ("5.2", 310),
    "references_dropped": ("5.2", 310),
    "stream_number": ("12.3", 550),
}
SWAPPED: dict[tuple[str, str], Row] = {
    ("time_ns", "cycle"): ("7.7", 895),
    ("fault", "severity"): ("7.6", 514),
    ("q_meas", "q_cmd"): ("7.7", 518),
    ("q_cmd", "valves"): ("7.7", 513),
    ("X_BT", "X_BT_cmd"): ("6.7", 518),
    ("lateness_p50_us", "lateness_p99_us"): ("7.7", 512),
    ("lateness_p99_us", "lateness_max_us"): ("7.7", 512),
    ("references_lost", "references_dropped"): ("5.2", 310),
}
ALWAYS: dict[str, tuple[dict[str, Any], Row]] = {
    "no valve": ({"valves": ZERO}, ("7.7", 518)),
    "done": ({"motion_done": True}, ("7.8", 516)),
    "no supply": ({"supply_bar": 0.0}, ("7.7", 512)),
    "segment 1": ({"segment": 1}, ("6.8", 557)),
    "no severity": ({"severity": Severity.NONE}, ("7.6", 514)),
    "a stop": ({"severity": Severity.STOP}, ("7.6", 514)),
    "standby": ({"group_state": GroupState.STANDBY}, ("7.2", 811)),
}
FLAGS: dict[tuple[int, bool], tuple[str, Row]] = {
    (FLAG_PLANT_LINK_OK, False): ("no plant link", ("7.7", 518)),
    (FLAG_EMERGENCY_LATCHED, False): ("no emergency", ("7.4", 507)),
    (FLAG_EMERGENCY_LATCHED, True): ("an emergency", ("7.4", 509)),
    (FLAG_SETTLED, False): ("not settled", ("7.8", 517)),
    (FLAG_SETTLED, True): ("settled", ("7.8", 516)),
    (FLAG_STREAMING, False): ("no stream", ("12.2", 544)),
    (FLAG_STREAMING, True): ("a stream", ("7.7", 821)),
}


def _of_fields() -> Iterator[BrokenController]:
    def broken(name: str, row: Row, make: Make) -> BrokenController:
        clause, case = row
        return BrokenController(name, clause, make, case=case)

    for name, row in STALE.items():
        yield broken(f"{name} 200 ms old", row, _shows(partial(_stale, name)))
    for name, row in FROZEN.items():
        yield broken(f"{name} frozen", row, _frozen(name))
    for pair, row in SWAPPED.items():
        yield broken(f"{' and '.join(pair)} swapped", row, _shows(partial(_swapped, *pair)))
    for name, (value, row) in ALWAYS.items():
        yield broken(f"always {name}", row, _shows(lambda _, value=value: value))
    for (bit, on), (name, row) in FLAGS.items():
        yield broken(f"flag: always {name}", row, _shows(partial(_flag, bit, on)))


def _negates_the_valves(_: Any, state: State) -> State:
    return state._replace(valves=tuple(-valve for valve in state.valves))


def _keeps(*fields: str) -> Make:
    """Shows these fields of the last drive for as long as nothing is driven."""

    def shown(self: Any, state: State) -> State:
        held = state.group_state in (GroupState.DISABLED, GroupState.ERROR_STOP) and not any(state.valves)
        if not held or self.live is None:
            self.live = state
            return state
        return state._replace(**{name: getattr(self.live, name) for name in fields})

    return hooked(live=None, shown=shown)


def _slower_states(factor: float, after_s: float) -> Make:
    """Sends STATE at a share of the granted rate, from ``after_s`` on."""

    def scan(self: Any) -> None:
        session = self.server._session
        if session is not None:
            start = self._clock_ns(), session.welcome.state_period_ms
            begun_ns, period_ms = self.granted.setdefault((id(self), session.channel.session), start)
            if period_ms and self._clock_ns() - begun_ns > after_s * 1e9:
                slowed = max(round(period_ms * factor), 1)
                session.welcome = session.welcome._replace(state_period_ms=slowed)
        ControllerUnderTest._scan(self)

    return hooked(granted={}, _scan=scan)


def _fault_ends_with_session(self: Any, data: bytes) -> bytes:
    if data[6:7] == bytes([Kind.HELLO]):
        self.bench.state = self.bench.state._replace(fault=NO_FAULT, severity=Severity.NONE)
    return data


def _latches(latched: Callable[[Any, Any], dict[str, Any]]) -> Make:
    """Latches otherwise than 7.6: ``latched`` gets the scan's state of before and after a scan."""

    def scan(self: Any) -> None:
        before = self.bench.state
        ControllerUnderTest._scan(self)
        self.bench.state = self.bench.state._replace(**latched(before, self.bench.state))

    return hooked(_scan=scan)


def _newest_fault(before: Any, after: Any) -> dict[str, Any]:
    emergency = after.mode is Mode.EMERGENCY and before.mode is not Mode.EMERGENCY
    return {"fault": Fault(FaultCode.EMERGENCY_STOP, 0.0, 0.0)} if emergency else {}


def _first_severity(before: Any, after: Any) -> dict[str, Any]:
    kept = before.severity is not Severity.NONE and after.severity > before.severity
    return {"severity": before.severity} if kept else {}


def _cleared_by_release(before: Any, after: Any) -> dict[str, Any]:
    released = before.mode is Mode.EMERGENCY and after.mode is Mode.ERROR_HELD
    return {"fault": NO_FAULT, "severity": Severity.NONE} if released else {}


def _kept_at_reset(name: str, before: Any, after: Any) -> dict[str, Any]:
    reset = before.mode is Mode.ERROR_HELD and after.mode is Mode.DISABLED
    return {name: getattr(before, name)} if reset else {}


def _other_link(mode: Mode, then: Mode) -> Make:
    """Reacts otherwise to a lost link in one mode."""
    cell = mode, Stimulus.UNATTENDED

    def scan(self: Any) -> None:
        before = self.bench.state.mode
        with patch.dict(TRANSITIONS, {cell: TRANSITIONS[cell]._replace(mode=then)}):
            ControllerUnderTest._scan(self)
        # The scan knows this one by itself.
        if before is mode is Mode.MOVING and self.bench.state.mode is Mode.ERROR_RAMP:
            self.bench.state = self.bench.state._replace(mode=then)

    return hooked(_scan=scan)


def _stopped_is_done(_: Any, state: State) -> State:
    return state._replace(motion_done=state.group_state is GroupState.STANDBY and state.motion_id != 0)


def _done_is_taken_back(self: Any, state: State) -> State:
    self.since = self.since + 1 if state.motion_done else 0
    return state._replace(motion_done=0 < self.since < 20)


OTHERS: tuple[tuple[str, str, int, Make], ...] = (
    ("the valves have the other sign", "7.7", 518, hooked(shown=_negates_the_valves)),
    ("the command stays", "7.7", 513, _keeps("q_cmd", "X_BT_cmd")),
    ("follows in joints only", "7.7", 513, _keeps("X_BT_cmd")),
    ("a new session clears the fault", "7.6", 514, hooked(incoming=_fault_ends_with_session)),
    ("a new session clears the emergency's fault", "7.4", 515, hooked(incoming=_fault_ends_with_session)),
    ("a motion that was stopped is done", "7.8", 517, hooked(shown=_stopped_is_done)),
    ("done is taken back after 100 ms", "7.8", 516, hooked(since=0, shown=_done_is_taken_back)),
    ("latches the newest fault", "7.6", 514, _latches(_newest_fault)),
    ("latches the first severity", "7.6", 514, _latches(_first_severity)),
    ("EMERGENCY_RELEASE clears the fault", "7.6", 514, _latches(_cleared_by_release)),
    ("RESET keeps the severity", "7.6", 514, _latches(partial(_kept_at_reset, "severity"))),
    ("RESET keeps the fault", "7.6", 514, _latches(partial(_kept_at_reset, "fault"))),
    *(
        (f"STATE at {1 / factor:g} of its rate, from {after_s:g} s on", "7.7", 411,
         _slower_states(factor, after_s))
        for factor, after_s in ((1.25, 0.0), (2.0, 0.0), (2.0, 1.0), (0.5, 0.0))
    ),
    *(
        (f"a lost link in {mode.name} leads to {then.name}", "7.5", case, _other_link(mode, then))
        for mode, then, case in (
            (Mode.STANDBY, Mode.STANDBY, 540), (Mode.STANDBY, Mode.ERROR_HELD, 540),
            (Mode.MOVING, Mode.STOPPING, 529), (Mode.MOVING, Mode.DISABLING, 529),
            (Mode.MOVING, Mode.ERROR_HELD, 860), (Mode.STOPPING, Mode.STOPPING, 539),
            (Mode.DISABLING, Mode.ERROR_RAMP, 519),
        )
    ),
)  # fmt: skip
MUTANTS = (
    *_of_fields(),
    *(BrokenController(name, clause, make, case=case) for name, clause, case, make in OTHERS),
)
