"""The transition table: total, and safe in the ways that matter."""

import pytest

from controller.core.group_states import LIVE, TRANSITIONS, Stimulus, transition
from protocol.axes_group import GROUP_STATE, Mode
from protocol.faults import CommandCode, GroupState, Reason

COMMANDS = [Stimulus(code) for code in CommandCode]
OWN = [Stimulus.STANDSTILL, Stimulus.FAULT_STOP, Stimulus.FAULT_EMERGENCY, Stimulus.UNATTENDED]


def test_every_mode_and_stimulus_is_defined_with_a_reason() -> None:
    assert set(TRANSITIONS) == {(mode, stimulus) for mode in Mode for stimulus in Stimulus}
    assert {GROUP_STATE[mode] for mode in Mode} == set(GroupState)
    assert all(isinstance(step.reason, Reason) for step in TRANSITIONS.values())


def test_commands_carry_their_numbers_on_the_link() -> None:
    assert {code.name: int(code) for code in CommandCode} == {s.name: int(s) for s in COMMANDS}


def test_a_refusal_changes_nothing() -> None:
    for (mode, _), step in TRANSITIONS.items():
        if step.reason is not Reason.ACCEPTED:
            assert step.mode is mode


@pytest.mark.parametrize("mode", Mode)
def test_stop_is_always_accepted_and_never_leads_into_motion(mode: Mode) -> None:
    step = transition(mode, Stimulus.STOP)
    assert step.reason is Reason.ACCEPTED
    assert step.mode is not Mode.MOVING


@pytest.mark.parametrize("mode", Mode)
def test_emergency_stop_reaches_its_latch_from_everywhere(mode: Mode) -> None:
    assert transition(mode, Stimulus.EMERGENCY_STOP).mode is Mode.EMERGENCY


def test_only_a_release_leaves_the_emergency_latch_and_only_a_reset_the_error() -> None:
    for stimulus in Stimulus:
        leaves = transition(Mode.EMERGENCY, stimulus).mode is not Mode.EMERGENCY
        assert leaves == (stimulus is Stimulus.EMERGENCY_RELEASE)
        after = transition(Mode.ERROR_HELD, stimulus).mode
        assert (after not in (Mode.ERROR_HELD, Mode.EMERGENCY)) == (stimulus is Stimulus.RESET)
    assert transition(Mode.EMERGENCY, Stimulus.EMERGENCY_RELEASE).mode is Mode.ERROR_HELD
    assert transition(Mode.ERROR_HELD, Stimulus.RESET).mode is Mode.DISABLED


def test_only_enable_makes_a_dead_group_live() -> None:
    for (mode, stimulus), step in TRANSITIONS.items():
        if mode not in LIVE and step.mode in LIVE:
            assert (mode, stimulus) == (Mode.DISABLED, Stimulus.ENABLE)


def test_only_a_reference_starts_motion_and_only_where_the_group_is_enabled() -> None:
    begins = {
        (mode, stimulus, step.mode)
        for (mode, stimulus), step in TRANSITIONS.items()
        if GROUP_STATE[mode] is not GroupState.MOVING and GROUP_STATE[step.mode] is GroupState.MOVING
    }
    assert begins == {
        (Mode.STANDBY, Stimulus.MOVE, Mode.MOVING),
        (Mode.STANDBY, Stimulus.START_STREAM, Mode.STREAMING),
    }


def test_a_stream_is_opened_by_its_command_alone_and_closed_by_what_ends_motion() -> None:
    for (mode, stimulus), step in TRANSITIONS.items():
        if mode is not Mode.STREAMING and step.mode is Mode.STREAMING:
            assert (mode, stimulus) == (Mode.STANDBY, Stimulus.START_STREAM)
        if mode is not Mode.STREAMING and stimulus is Stimulus.STREAMED:
            assert step.reason is not Reason.ACCEPTED
            assert step.mode is mode


@pytest.mark.parametrize("mode", [mode for mode in Mode if mode in LIVE])
def test_faults_end_every_live_mode(mode: Mode) -> None:
    assert transition(mode, Stimulus.FAULT_EMERGENCY).mode is Mode.ERROR_HELD
    assert transition(mode, Stimulus.FAULT_STOP).mode is Mode.ERROR_RAMP
    assert transition(Mode.ERROR_RAMP, Stimulus.STANDSTILL).mode is Mode.ERROR_HELD


def test_own_stimuli_never_enable_nor_move() -> None:
    for mode in Mode:
        for stimulus in OWN:
            after = transition(mode, stimulus).mode
            assert GROUP_STATE[after] is not GroupState.MOVING or after is mode
            assert after not in LIVE or mode in LIVE
