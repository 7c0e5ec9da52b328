"""STATEs on the tester's clock, by the offset that heartbeats bound (5.5); and poses turned."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from statistics import median
from typing import NamedTuple

from conformance.case import case
from conformance.peer import Peer
from conformance.reference.arm_transitions import ReachedMode, entered, is_ramping
from conformance.reference.motion import (
    CENTRED,
    accepted,
    disabled,
    expect_reason,
    reach,
    require_near,
    require_reason,
    require_shown,
)
from conformance.reference.streaming import BOTH
from conformance.wire import MS, known, require
from protocol.axes_group import Mode
from protocol.clock_offset import ClockOffset
from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.pose import Pose
from protocol.reference_messages import FLAG_PLANT_LINK_OK, FLAG_SETTLED, ReferencePose, State

_ECHOES = 12
_RAREST_MS = 100.0


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
        found = known(clock.estimate(peer.now_ns), "no offset fits the echoes of the heartbeats")
        # By so much more an instant is uncertain that STATE tells by the first of several.
        self.period_ms = max(peer.welcome.state_period_ms, peer.welcome.cycle_ns / MS)
        self.offset_ns = found.offset_ns
        self.uncertainty_ms = found.uncertainty_ns / MS

    def next(self, wait_ms: float = 500.0) -> Watched:
        """The next STATE; raises Failed when none comes."""
        return self._watched(self.peer.expect(State, "STATE", wait_ms))

    def _watched(self, state: State) -> Watched:
        return Watched(state.time_ns - self.offset_ns, self.peer.now_ns, state)

    def during(self, wait_ms: float, until: Callable[[State], bool] = lambda state: False) -> list[Watched]:
        """The STATEs of ``wait_ms``, of a long one at least one, or until one, the last, is as wanted."""
        seen: list[Watched] = []
        for datagram in self.peer.arriving(wait_ms):
            if not isinstance(datagram.message, State):
                self.peer.passed_over.append(datagram)
                continue
            seen.append(self._watched(datagram.message))
            if until(seen[-1].state):
                break
        return seen if seen or wait_ms < _RAREST_MS else [self.next()]

    def until(self, wanted: Callable[[State], bool], wait_ms: float, why: str) -> list[Watched]:
        """The STATEs until one, the last, is ``wanted``. Raises Failed with ``why`` after ``wait_ms``."""
        seen = self.during(wait_ms, until=wanted)
        require(wanted(seen[-1].state), why)
        return seen


def watched(peer: Peer, mode: Mode) -> tuple[ReachedMode, StateWatch]:
    """A mode that was reached, as ``entered``, and a watch that was made in it."""
    return entered(peer, mode), StateWatch(peer)


Axis = tuple[float, float, float]


def turned(pose: Pose, angle: float, axis: Axis = (0.0, 0.0, 1.0), *, in_base: bool = False) -> Pose:
    """``pose`` turned by ``angle`` (rad) about an axis of its own T, by default the last joint's, or of B."""
    s = math.sin(angle / 2.0)
    turn = (math.cos(angle / 2.0), *(s * c for c in axis))
    return pose._replace(q_wxyz=_product(turn, pose.q_wxyz) if in_base else _product(pose.q_wxyz, turn))


def _product(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float, float]:
    w, x, y, z = a
    p, q, r, s = b
    return (
        w * p - x * q - y * r - z * s,
        w * q + x * p + y * s - z * r,
        w * r - x * s + y * p + z * q,
        w * s + x * r - y * q + z * p,
    )


# What a busy machine adds to the age of a STATE; half of them are younger than with the smaller one.
LATE_MS, OFTEN_LATE_MS = 30.0, 3.0
# Of what follows the measurement in the same scan: two digits of an encoder, and a rounding.
SAME_RAD, SAME_M = 1e-4, 1e-6
SETTLES_MS = 25_000.0
# A measurement may be ahead of its command now and then; one that mostly is, is the command.
MOSTLY = 0.5


@case(511, "7.7", "STATE is of the present: a scan old when it comes")
def present(peer: Peer) -> None:
    cycle_ms = peer.open(period_ms=0).cycle_ns / MS
    watch = StateWatch(peer)
    ages = [each.age_ms for each in watch.during(400.0)]
    require(min(ages) > -watch.uncertainty_ms - 1.0, f"STATE is {-min(ages):.1f} ms from the future")
    require(median(ages) < cycle_ms + OFTEN_LATE_MS + watch.uncertainty_ms, f"{median(ages):.1f} ms old")
    require(max(ages) < cycle_ms + LATE_MS + watch.uncertainty_ms, f"up to {max(ages):.1f} ms old")


@case(512, "7.7", "STATE counts: lateness in order, overruns never fall, the supply has a pressure", opens=0)
def counts(peer: Peer) -> None:
    states = [each.state for each in StateWatch(peer).during(200.0)]
    for a, b in pairwise(states):
        for name in ("overruns", "lateness_max_us", "plant_exchange_failures"):
            require(getattr(b, name) >= getattr(a, name), f"{name} fell")
        ordered = b.lateness_p50_us <= b.lateness_p99_us <= b.lateness_max_us
        require(ordered, "the median, the 99th percentile and the greatest lateness are not in order")
    state = states[-1]
    if state.flags & FLAG_PLANT_LINK_OK:
        require(1.0 < state.supply_bar < 1000.0, f"a supply pressure of {state.supply_bar:g} bar")


def require_following(states: Sequence[State]) -> None:
    """Raises Failed unless command and measurement are the same: nothing is driven."""
    for state in states:
        off = max(abs(c - m) for c, m in zip(state.q_cmd, state.q_meas, strict=True))
        require(off < SAME_RAD, f"q_cmd is {off * 1e3:.2f} mrad from q_meas although nothing is driven")
        off = math.dist(state.X_BT_cmd.p_m, state.X_BT.p_m)
        require(off < SAME_M, f"X_BT_cmd is {off * 1e3:.2f} mm from X_BT although nothing is driven")


@case(513, "7.7", "while the valves are not driven the command follows the measurement", motion=True)
def follows_measurement(peer: Peer) -> None:
    entered(peer, Mode.MOVING)
    require_reason(peer, CommandCode.EMERGENCY_STOP, Reason.ACCEPTED, "MOVING")
    peer.state()
    watch = StateWatch(peer)
    require_following([each.state for each in watch.during(500.0)])
    require_reason(peer, CommandCode.EMERGENCY_RELEASE, Reason.ACCEPTED, "emergency")
    require_reason(peer, CommandCode.RESET, Reason.ACCEPTED, "error")
    reach(peer, GroupState.DISABLED, "after RESET")
    require_following([each.state for each in watch.during(300.0)])


@case(514, "7.6", "the first fault stays latched, the gravest severity is shown, until RESET", motion=True)
def first_fault(peer: Peer) -> None:
    def shows(severity: Severity, when: str) -> None:
        require_shown(peer.state(), when, fault=FaultCode.REFERENCE_LINK_LOST, severity=severity)

    entered(peer, Mode.ERROR_RAMP)
    for state in peer.states(3000):
        if not is_ramping(state):
            break
    shows(Severity.STOP, "after a motion whose session ended")
    require_reason(peer, CommandCode.EMERGENCY_STOP, Reason.ACCEPTED, "error")
    shows(Severity.EMERGENCY, "after EMERGENCY_STOP")
    peer.reopen(capabilities=BOTH, period_ms=0)
    shows(Severity.EMERGENCY, "in a new session")
    require_reason(peer, CommandCode.EMERGENCY_RELEASE, Reason.ACCEPTED, "emergency")
    shows(Severity.EMERGENCY, "after EMERGENCY_RELEASE")
    require_reason(peer, CommandCode.RESET, Reason.ACCEPTED, "error")
    require_shown(peer.state(), "after RESET", fault=FaultCode.NONE, severity=Severity.NONE)


@case(515, "7.6", "EMERGENCY_STOP without a fault before it is the fault, with its severity")
def emergency_is_the_fault(peer: Peer) -> None:
    disabled(peer)
    require_shown(peer.state(), "without a fault", severity=Severity.NONE)
    require_reason(peer, CommandCode.EMERGENCY_STOP, Reason.ACCEPTED, "DISABLED")
    peer.reopen(period_ms=20)
    emergency, severity = FaultCode.EMERGENCY_STOP, Severity.EMERGENCY
    require_shown(peer.state(), "in a new session", fault=emergency, severity=severity)


def _drive_to(watch: StateWatch, goal: Pose, seconds: float) -> tuple[int, list[Watched]]:
    """The id of a motion to ``goal``, and its STATEs until it is done."""
    peer = watch.peer
    motion_id = accepted(peer, ReferencePose(peer.new_id(), goal, seconds))
    peer.drain()
    return motion_id, watch.until(
        lambda state: state.motion_done, seconds * 1e3 + SETTLES_MS, "it is not done"
    )


@case(516, "7.8", "motion_done is 0 until the motion has ended, then 1; a refusal leaves it", motion=True)
def done_at_its_end(peer: Peer) -> None:
    scene, watch = watched(peer, Mode.STANDBY)
    motion_id, seen = _drive_to(watch, scene.goal, 0.8)
    for each in seen[:-1]:
        require(each.state.motion_id == motion_id, "motion_id is not the motion's")
        require(not each.state.flags & FLAG_SETTLED, "SETTLED while it moves")
        require(each.state.group_state is GroupState.MOVING, f"{each.state.group_state.name} while it moves")
    require_near(seen[-1].state.X_BT_cmd, scene.goal, 1e-6, "done before its end")
    require(all(each.state.motion_done for each in watch.during(300.0)), "motion_done is taken back")
    _, seen = _drive_to(watch, scene.here, 0.8)
    require_near(seen[-1].state.X_BT_cmd, scene.here, 1e-6, "the next one is done before its end")
    nan = scene.here._replace(p_m=(math.nan, 0.0, 0.0))
    expect_reason(peer.ask(ReferencePose(peer.new_id(), nan, 0.0), "NaN"), Reason.NOT_FINITE, "NaN")
    motion_id = seen[-1].state.motion_id
    require_shown(peer.state(), "after a refusal", motion_done=True, motion_id=motion_id)


@case(517, "7.8", "a motion that was stopped is not done, and SETTLED says that the arm rests", motion=True)
def stopped_is_not_done(peer: Peer) -> None:
    entered(peer, Mode.STOPPING)
    seen = StateWatch(peer).until(
        lambda state: bool(state.flags & FLAG_SETTLED), SETTLES_MS, "it does not settle after STOP"
    )
    require(not any(each.state.motion_done for each in seen), "done although it was stopped")
    require_reason(peer, CommandCode.DISABLE, Reason.ACCEPTED, "STANDBY")
    require(not peer.state().flags & FLAG_SETTLED, "SETTLED although it is disabled")


def _leads(ahead: Sequence[float]) -> bool:
    """Whether the command is not behind (negative) the measurement in most of what they differ by."""
    return sum(ahead) >= -MOSTLY * sum(map(abs, ahead))


@case(518, "7.7", "in motion the measurement follows the command, and the valves drive it", motion=True)
def measured_follows(peer: Peer) -> None:
    scene, watch = watched(peer, Mode.STANDBY)
    begin = peer.state()
    _, seen = _drive_to(watch, scene.goal, 1.2)
    states = [each.state for each in (*seen, *watch.during(300.0))]
    last = states[-1]
    joint = max(range(6), key=lambda j: abs(last.q_cmd[j] - begin.q_cmd[j]))
    on_its_way = states[: max(len(states) // 2, 4)]
    travel = [end - first for end, first in zip(last.q_cmd, begin.q_cmd, strict=True)]
    ahead = [  # of all joints: a wrist without a load may lead
        sum(t * (c - m) for t, c, m in zip(travel, s.q_cmd, s.q_meas, strict=True)) for s in on_its_way
    ]
    require(_leads(ahead), "q_meas is ahead of q_cmd")
    ahead = [s.X_BT_cmd.p_m[2] - s.X_BT.p_m[2] for s in on_its_way]
    require(_leads(ahead), "X_BT is ahead of X_BT_cmd")
    require(abs(last.q_meas[joint] - begin.q_meas[joint]) > 1e-3, "q_meas does not move with the arm")
    require(abs(last.X_BT.p_m[2] - begin.X_BT.p_m[2]) > 0.01, "X_BT does not move with the arm")
    for s in states:
        off = max(abs(c - m) for c, m in zip(s.q_cmd, s.q_meas, strict=True))
        require(off < 0.1, f"q_cmd and q_meas are {off:.3f} rad apart")
    require(any(s.flags & FLAG_PLANT_LINK_OK for s in states), "it moves although PLANT_LINK_OK is not set")
    drive = sum(s.valves[joint] for s in states) * (last.q_cmd[joint] - begin.q_cmd[joint])
    require(drive > 0.0, f"the valve of joint {joint + 1} does not drive it where it goes")


@case(540, "7.5", "a silent link in STANDBY drops the enable without a fault", motion=True)
def unattended(peer: Peer) -> None:
    entered(peer, Mode.STANDBY)
    peer.collect(peer.timeout_ms + 100, beating=False)
    peer.open(period_ms=0)
    off, sound = GroupState.DISABLED, FaultCode.NONE
    require_shown(peer.state(), "after a silent link", group_state=off, fault=sound, valves=CENTRED)


@case(519, "7.5", "BYE while DISABLING: the ramp is finished, and nothing is latched", motion=True)
def ends_while_disabling(peer: Peer) -> None:
    entered(peer, Mode.DISABLING)
    peer.reopen(capabilities=BOTH, period_ms=0)
    state = reach(peer, GroupState.DISABLED, "after BYE while DISABLING", 3000)
    require_shown(state, "after BYE while DISABLING", fault=FaultCode.NONE)
