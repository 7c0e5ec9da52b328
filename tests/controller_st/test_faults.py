"""A program that goes wrong in the loop: the arm is stopped, the line is named, the process lives."""

import json
import subprocess
import sys
from collections.abc import Callable

import pytest

from conformance.case import CaseOutcome
from conformance.runner import run_reference
from controller_st import program
from controller_st.parts import text_parts
from protocol.faults import CommandCode, FaultCode, GroupState
from protocol.process_image import CONTROL_ENABLE
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.world import World
from testbed.scenarios.scenario import load_settings
from tests.support.paths import CONFIGS, ROOT

# The first statement of F_LR_Drive, which is reached in every scan.
BEFORE = "F_LR_Drive := FALSE;\n"
WRONG = {
    "an index is outside of its array": "stArm.stServo.aValves[ULINT_TO_DINT(stArm.nCycle / 42)] := 0.0;",
    "division by zero": "fPace := 1.0 / ULINT_TO_LREAL(stArm.nCycle MOD 250);",
    "a loop does not end": "WHILE stArm.nCycle > 250 DO fPace := 1.0; END_WHILE",
}


@pytest.fixture
def broken(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], World]:
    """A world whose controller has one more statement."""

    def made(statement: str) -> World:
        sound = program.texts

        def texts(*given: object) -> dict[str, str]:
            found = sound(*given)  # type: ignore[arg-type]
            assert BEFORE in found["group.st"]
            return found | {"group.st": found["group.st"].replace(BEFORE, BEFORE + statement + "\n")}

        monkeypatch.setattr(program, "texts", texts)
        return World(load_settings(CONFIGS, {}), 1, RunLog(), text_parts)

    return made


@pytest.mark.slow("three programs are compiled")
@pytest.mark.parametrize("why", WRONG)
def test_a_fault_in_a_scan_stops_the_arm_and_names_its_line(broken: Callable[[str], World], why: str) -> None:
    world = broken(WRONG[why])
    line = (
        program.texts(world.settings.arm, world.settings.controller)["group.st"].split(BEFORE)[0].count("\n")
        + 2
    )
    world.connect()
    run(world.link.command(CommandCode.ENABLE))
    said = ""
    for _ in range(400):
        world.step()
        events = [e for e in world.log.events if e["event"] == "controller" and "NUMERIC" in str(e["what"])]
        if events:
            said = str(events[0]["what"])
            break
    assert f"group.st:{line}: {why}" in said
    for _ in range(8):  # what it left for the plant has its enable dropped, now and from now on
        assert not world.controller.valve_words[1] & CONTROL_ENABLE
        assert world.controller.valve_words[2:8] == [0] * 6
        world.step()
    state = world.states[-1]
    assert (state.group_state, state.fault) == (GroupState.ERROR_STOP, FaultCode.NUMERIC)


@pytest.mark.realtime
@pytest.mark.slow("a process is started")
def test_as_a_process_it_serves_and_ends_when_asked_to() -> None:
    command = [sys.executable, "-m", "controller_st", "--config-dir", str(CONFIGS), "--set"]
    command += ["controller.reference_link.port=0", "controller.plant_link.port=1"]
    process = subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert process.stdout is not None
    try:
        port = json.loads(process.stdout.readline())["reference_link"]["port"]
        summary = run_reference("127.0.0.1", port, numbers=[101, 203, 231, 301, 401, 722])
    finally:
        process.terminate()
        assert process.wait(10.0) == 0
        process.stdout.close()
    assert [r.detail for r in summary.results if r.outcome is not CaseOutcome.PASS] == []
