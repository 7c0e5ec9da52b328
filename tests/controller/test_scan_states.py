"""Commands and references through the scan: answers, guards, what reaches the valves."""

import itertools

import numpy as np
import pytest
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from controller.config import ControllerConfig
from controller.core.group_states import Stimulus, transition
from controller.core.settings import ScanSettings, settings_from
from foundation.configuration import load
from nominal_arm.description import NominalArm
from protocol.axes_group import GROUP_STATE, Mode
from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.process_image import (
    CONTROL_ENABLE,
    CONTROL_RESET_WATCHDOG,
    STATUS_SUPPLY_ON,
    STATUS_WATCHDOG_TRIPPED,
)
from protocol.reference_messages import (
    FLAG_EMERGENCY_LATCHED,
    FLAG_SETTLED,
    FLAG_STREAMING,
    Command,
    ReferencePath,
)
from tests.controller.conftest import CONFIGS
from tests.controller.obedient_plant import Bench

ZERO = (0.0,) * 6


def _brought_to(bench: Bench, mode: Mode) -> Bench:
    """The bench in ``mode``, by the shortest honest way."""
    if mode is Mode.DISABLED:
        bench.step()
    elif mode is Mode.STANDBY:
        bench.enabled()
    elif mode is Mode.STREAMING:
        bench.streaming()
    else:
        bench.moving()
    if mode is Mode.STOPPING:
        bench.command(CommandCode.STOP)
    elif mode is Mode.DISABLING:
        bench.command(CommandCode.DISABLE)
    elif mode is Mode.ERROR_RAMP:
        bench.link_alive = False
        bench.step()
        bench.link_alive = True
    elif mode is Mode.ERROR_HELD:
        bench.status = STATUS_SUPPLY_ON | STATUS_WATCHDOG_TRIPPED
        bench.step()
        bench.status = STATUS_SUPPLY_ON
        bench.step()
    elif mode is Mode.EMERGENCY:
        bench.command(CommandCode.EMERGENCY_STOP)
    assert bench.state.mode is mode
    return bench


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("stimulus", [s for s in Stimulus if s <= Stimulus.STREAMED])
def test_every_state_answers_every_command_as_the_table_says(
    settings: ScanSettings, mode: Mode, stimulus: Stimulus
) -> None:
    bench = _brought_to(Bench(settings), mode)
    if stimulus is Stimulus.MOVE:
        reason = bench.refer(bench.shifted(z=0.05)).reason
    elif stimulus is Stimulus.STREAMED:
        refusal = bench.stream(1000, bench.shifted(z=0.05))
        reason = refusal.reason if refusal else Reason.ACCEPTED
    else:
        reason = bench.command(CommandCode(stimulus))
    want = transition(mode, stimulus)
    assert reason is want.reason
    assert bench.state.mode is want.mode
    assert bench.last.view.group_state is GROUP_STATE[want.mode]
    assert bool(bench.last.view.flags & FLAG_STREAMING) == (want.mode is Mode.STREAMING)
    live = want.mode not in (Mode.DISABLED, Mode.ERROR_HELD, Mode.EMERGENCY)
    assert bool(bench.last.valves.control & CONTROL_ENABLE) == live
    assert live or bench.last.valves.valves == ZERO


def test_enabling_moves_nothing(settings: ScanSettings) -> None:
    bench = Bench(settings).enabled()
    bench.run(2.0)
    assert all(output.valves.valves == pytest.approx(ZERO, abs=1e-6) for output in bench.outputs)
    assert bench.last.view.q_cmd == pytest.approx(bench.last.view.q_meas, abs=1e-6)
    assert bench.last.view.flags & FLAG_SETTLED


def test_a_reference_is_followed_to_its_end_and_settles(settings: ScanSettings) -> None:
    bench = Bench(settings).enabled()
    goal = bench.shifted(x=0.1, y=0.2, z=-0.1)
    command_id = bench.refer(goal).command_id
    assert bench.last.view.motion_id == command_id
    assert not bench.last.view.motion_done
    assert not bench.last.view.flags & FLAG_SETTLED
    bench.run(10.0)
    view = bench.last.view
    assert view.motion_done
    assert view.flags & FLAG_SETTLED
    assert view.group_state is GroupState.STANDBY
    assert view.X_BT.p_m == pytest.approx(goal.p_m, abs=5e-4)


def test_a_path_counts_its_segments(settings: ScanSettings) -> None:
    bench = Bench(settings).enabled()
    waypoints = tuple(bench.shifted(y=0.02 * k) for k in range(1, 25))
    answer = bench.step(ReferencePath(900, waypoints, 0.0, 0.1)).acknowledgements[0]
    assert (answer.command_id, answer.reason) == (900, Reason.ACCEPTED)
    seen = []
    while not bench.last.view.motion_done:
        bench.step()
        seen.append(bench.last.view.segment)
    assert sorted(set(seen)) == list(range(24))
    assert seen == sorted(seen)


def test_a_new_reference_takes_over_without_a_jump(settings: ScanSettings) -> None:
    bench = Bench(settings).moving()
    assert bench.refer(bench.shifted(y=0.2)).reason is Reason.ACCEPTED
    bench.run(8.0)
    p = np.array([output.view.X_BT_cmd.p_m for output in bench.outputs])
    acceleration = np.diff(p, n=2, axis=0) / settings.cycle_s**2
    limit = settings.motion.acceleration
    assert np.linalg.norm(acceleration, axis=1).max() < 1.2 * limit
    assert bench.last.view.motion_done


def test_stop_ramps_down_and_holds(settings: ScanSettings) -> None:
    bench = Bench(settings).moving()
    speed_before = np.linalg.norm(bench.state.motion.desired.v)
    assert speed_before > 0.05
    assert bench.command(CommandCode.STOP) is Reason.ACCEPTED
    scans = 0
    while bench.last.view.group_state is GroupState.STOPPING:
        bench.step()
        scans += 1
    assert 0.2 < scans * settings.cycle_s < 2.0
    assert bench.last.view.group_state is GroupState.STANDBY
    assert not bench.last.view.motion_done
    held = bench.last.view.X_BT_cmd
    bench.run(1.0)
    assert bench.last.view.X_BT_cmd == held
    assert bench.last.valves.control & CONTROL_ENABLE


def test_disable_ramps_down_then_drops_the_enable(settings: ScanSettings) -> None:
    bench = Bench(settings).moving()
    assert bench.command(CommandCode.DISABLE) is Reason.ACCEPTED
    assert bench.last.valves.control & CONTROL_ENABLE
    bench.run(2.0)
    assert bench.last.view.group_state is GroupState.DISABLED
    assert bench.last.valves.control == 0


def test_emergency_stop_centres_at_once_and_needs_release_reset_enable(settings: ScanSettings) -> None:
    bench = Bench(settings).moving()
    assert any(bench.last.valves.valves)
    assert bench.command(CommandCode.EMERGENCY_STOP) is Reason.ACCEPTED
    assert bench.last.valves.valves == ZERO
    assert bench.last.valves.control == 0
    assert bench.last.view.flags & FLAG_EMERGENCY_LATCHED
    assert (bench.last.view.fault, bench.last.view.severity) == (FaultCode.EMERGENCY_STOP, Severity.EMERGENCY)
    assert ("fault", "EMERGENCY_STOP") in [event[:2] for event in bench.last.events]
    assert bench.command(CommandCode.RESET) is Reason.EMERGENCY_LATCHED
    assert bench.command(CommandCode.ENABLE) is Reason.EMERGENCY_LATCHED
    assert bench.command(CommandCode.EMERGENCY_RELEASE) is Reason.ACCEPTED
    assert bench.command(CommandCode.ENABLE) is Reason.ERROR_LATCHED
    assert bench.command(CommandCode.RESET) is Reason.ACCEPTED
    assert bench.last.view.fault is FaultCode.NONE
    assert bench.refer(bench.shifted(z=0.1)).reason is Reason.DISABLED
    assert bench.command(CommandCode.ENABLE) is Reason.ACCEPTED


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda b: setattr(b, "link_alive", False), Reason.REFERENCE_LINK_DOWN),
        (lambda b: setattr(b, "supply_bar", 20.0), Reason.PLANT_NOT_READY),
        (lambda b: setattr(b, "status", 0), Reason.PLANT_NOT_READY),
    ],
)
def test_enable_is_guarded(settings: ScanSettings, spoil: object, reason: Reason) -> None:
    bench = Bench(settings)
    spoil(bench)  # type: ignore[operator]
    bench.step()
    assert bench.command(CommandCode.ENABLE) is reason
    assert bench.state.mode is Mode.DISABLED


def test_enable_without_a_plant_is_refused(settings: ScanSettings) -> None:
    bench = Bench(settings, silent=True)
    bench.step()
    assert bench.command(CommandCode.ENABLE) is Reason.PLANT_LINK_DOWN


def test_a_tripped_plant_watchdog_is_rearmed_while_disabled(settings: ScanSettings) -> None:
    bench = Bench(settings, status=STATUS_SUPPLY_ON | STATUS_WATCHDOG_TRIPPED)
    bench.step()
    assert bench.last.valves.control & CONTROL_RESET_WATCHDOG, "the first edge is not waited for"
    bench.run(0.01)
    assert not bench.last.valves.control & CONTROL_RESET_WATCHDOG
    assert bench.command(CommandCode.ENABLE) is Reason.ACCEPTED


@pytest.mark.parametrize("scans", range(1, 20))
def test_enable_may_follow_reset_at_once(settings: ScanSettings, scans: int) -> None:
    """Whenever the two come after the watchdog's fault: RESET, and ENABLE in the same scan."""
    bench = Bench(settings).moving()
    bench.status = STATUS_SUPPLY_ON | STATUS_WATCHDOG_TRIPPED
    for _ in range(scans + 1):
        bench.step()
    assert bench.state.mode is Mode.ERROR_HELD, "re-arming clears no fault"
    answers = bench.step(Command(900, CommandCode.RESET), Command(901, CommandCode.ENABLE)).acknowledgements
    assert [answer.reason for answer in answers] == [Reason.ACCEPTED, Reason.ACCEPTED]


def test_enable_may_follow_release_and_reset_at_once(settings: ScanSettings) -> None:
    bench = Bench(settings).moving()
    bench.command(CommandCode.EMERGENCY_STOP)
    bench.status = STATUS_SUPPLY_ON | STATUS_WATCHDOG_TRIPPED
    bench.run(0.02)
    codes = CommandCode.EMERGENCY_RELEASE, CommandCode.RESET, CommandCode.ENABLE
    answers = bench.step(*(Command(900 + code, code) for code in codes)).acknowledgements
    assert [answer.reason for answer in answers] == [Reason.ACCEPTED] * 3


def test_a_plant_that_hears_no_edge_gets_another_one(settings: ScanSettings) -> None:
    bench = Bench(settings, status=STATUS_SUPPLY_ON | STATUS_WATCHDOG_TRIPPED, hears_reset=False)
    bench.run(0.24)
    high = [bool(output.valves.control & CONTROL_RESET_WATCHDOG) for output in bench.outputs]
    edges = [k for k, (before, now) in enumerate(itertools.pairwise([False, *high])) if now and not before]
    assert edges == [0, 16, 32]
    assert not any(output.valves.control & CONTROL_ENABLE for output in bench.outputs)


def test_an_unknown_command_is_refused(settings: ScanSettings) -> None:
    bench = Bench(settings).enabled()
    answer = bench.step(Command(5, 77)).acknowledgements[0]  # type: ignore[arg-type]
    assert (answer.reason, answer.value) == (Reason.UNKNOWN_COMMAND, 77.0)


class GroupMachine(RuleBasedStateMachine):
    """The scan against an oracle of five facts; it knows nothing of the transition table."""

    def __init__(self) -> None:
        super().__init__()
        arm = load(NominalArm, CONFIGS / "arm.yaml")
        self.bench = Bench(settings_from(arm, load(ControllerConfig, CONFIGS / "controller.yaml")))
        self.enabled = self.moving = self.slowing = self.error = self.latched = False

    @initialize()
    def start(self) -> None:
        self.bench.step()

    def _oracle(self, code: CommandCode) -> Reason:
        if code is CommandCode.STOP:
            self.slowing |= self.moving
            return Reason.ACCEPTED
        if code is CommandCode.EMERGENCY_STOP:
            known = self.latched
            self.error = self.latched = True
            self.enabled = self.moving = self.slowing = False
            return Reason.ALREADY_DONE if known else Reason.ACCEPTED
        if code is CommandCode.EMERGENCY_RELEASE:
            known, self.latched = self.latched, False
            return Reason.ACCEPTED if known else Reason.ALREADY_DONE
        if code is CommandCode.RESET:
            if self.latched:
                return Reason.EMERGENCY_LATCHED
            known, self.error = self.error, False
            return Reason.ACCEPTED if known else Reason.NOT_IN_ERROR
        if code is CommandCode.END_STREAM:
            return Reason.NOT_STREAMING
        if code is CommandCode.DISABLE:
            known, self.enabled = self.enabled, False
            self.moving = self.slowing = False
            return Reason.ACCEPTED if known else Reason.ALREADY_DONE
        if self.error:
            return Reason.EMERGENCY_LATCHED if self.latched else Reason.ERROR_LATCHED
        known, self.enabled = self.enabled, True
        return Reason.ALREADY_DONE if known else Reason.ACCEPTED

    @rule(code=st.sampled_from([code for code in CommandCode if code is not CommandCode.START_STREAM]))
    def command(self, code: CommandCode) -> None:
        was_moving = self.moving
        assert self.bench.command(code) is self._oracle(code)
        if was_moving and code is CommandCode.DISABLE:
            self.bench.run(1.5)  # the ramp
        if self.slowing:
            self.bench.run(1.5)
            self.moving = self.slowing = False

    @rule(z=st.floats(-0.1, 0.1))
    def refer(self, z: float) -> None:
        answer = self.bench.refer(self.bench.shifted(z=z))
        if self.error:
            assert answer.reason is (Reason.EMERGENCY_LATCHED if self.latched else Reason.ERROR_LATCHED)
        elif not self.enabled:
            assert answer.reason is Reason.DISABLED
        else:
            assert answer.reason is Reason.ACCEPTED
            self.moving = True

    @precondition(lambda self: self.moving)
    @rule()
    def arrive(self) -> None:
        self.bench.run(6.0)
        self.moving = False
        assert self.bench.last.view.motion_done

    @rule()
    def idle(self) -> None:
        self.bench.run(0.05)

    @precondition(lambda self: self.moving)
    @rule()
    def link_falls_silent(self) -> None:
        self.bench.link_alive = False
        self.bench.run(1.5)
        self.bench.link_alive = True
        self.bench.step()
        self.error, self.enabled, self.moving = True, False, False
        assert self.bench.last.view.fault is FaultCode.REFERENCE_LINK_LOST

    @invariant()
    def agrees(self) -> None:
        view, valves = self.bench.last.view, self.bench.last.valves
        assert bool(view.flags & FLAG_EMERGENCY_LATCHED) == self.latched
        assert (view.group_state is GroupState.ERROR_STOP) == self.error
        assert (view.fault is FaultCode.NONE) == (not self.error)
        assert bool(valves.control & CONTROL_ENABLE) == self.enabled
        assert (view.group_state is GroupState.MOVING) == self.moving
        if not self.enabled:
            assert valves.valves == ZERO


TestGroupMachine = GroupMachine.TestCase
TestGroupMachine.settings = hypothesis_settings(max_examples=25, stateful_step_count=25, deadline=None)
