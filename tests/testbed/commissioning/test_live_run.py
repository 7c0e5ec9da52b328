"""`longreach commission` against a running controller: asked over its link, found in its records."""

import asyncio
import io
import json
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from controller.commissioning import basis_of
from controller.shell.scan_recorder import TrialRecords
from foundation.configuration import parse_overrides
from foundation.event_log import EventLog
from nominal_arm.commissioned import Commissioned
from protocol.errors import ConfigurationError, LongreachError
from protocol.faults import CommandCode
from testbed.commissioning.command import CommissionRequest, run_commission
from testbed.commissioning.recording import trials_told
from testbed.commissioning.runs import LiveController, excite_live, read_trial, with_excitation
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.world import World
from testbed.realtime.live_client import LiveClient
from testbed.scenarios.scenario import Settings, load_settings
from tests.controller.shell.plant_server import PlantServer, plant_server
from tests.support.paths import CONFIGS
from tests.support.patience import PATIENT

pytestmark = pytest.mark.realtime

READY_S = 60.0  # a first start compiles
CONTROLLER = (
    *PATIENT,
    "controller.reference_link.link_timeout_ms=20000",
    "controller.reference_link.port=0",
    "controller.fifo_priority=0",
)
DEAD = "controller.excitation.spool_max=0.004"  # the small plant moves from 0.005 on


def settings_with(*assignments: str) -> Settings:
    return load_settings(CONFIGS, parse_overrides([*CONTROLLER, *assignments]))


@asynccontextmanager
async def controller(server: PlantServer, records: Path, *assignments: str) -> AsyncIterator[LiveController]:
    chosen = (*CONTROLLER, f"controller.plant_link.port={server.port}", *assignments)
    command = (sys.executable, "-m", "controller", "--config-dir", str(CONFIGS), "--record-dir", str(records))
    process = await asyncio.create_subprocess_exec(
        *command, *(word for each in chosen for word in ("--set", each)),
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.DEVNULL,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        ready = json.loads(await asyncio.wait_for(process.stdout.readline(), READY_S))
        yield LiveController("127.0.0.1", ready["reference_link"]["port"], records)
    finally:
        process.terminate()
        await process.wait()


def excited(live: LiveController, settings: Settings) -> object:
    return excite_live(live, settings, lambda recording: None, lambda progress, note: None)


@pytest.mark.slow("services start")
async def test_what_breaks_it_off_comes_back_and_the_valves_are_centred(tmp_path: Path) -> None:
    mode = ("controller.excitation.enabled=true", "controller.excitation.joints=[5]", DEAD)
    async with plant_server() as server, controller(server, tmp_path, *mode) as live:
        ended = await asyncio.to_thread(
            excite_live, live, settings_with(DEAD), lambda recording: None, lambda progress, note: None
        )
        written = list(server.written)
    assert ended.trouble is not None
    assert (ended.trouble.cause, ended.trouble.joint) == ("commissioning.no_motion", 5)
    opened = [max(abs(u) for u in image.valves) for image in written]
    assert 0.003 < max(opened) < 0.006
    assert written[-1].valves == (0.0,) * 6
    _, samples = read_trial(tmp_path / "trial_wrist3_unfinished.jsonl")
    assert len(samples) > 10
    assert max(sample.valve for sample in samples) > 0.003


@pytest.mark.slow("services start")
async def test_a_controller_that_only_servos_is_named(tmp_path: Path) -> None:
    async with plant_server() as server, controller(server, tmp_path) as live:
        with pytest.raises(ConfigurationError) as raised:
            await asyncio.to_thread(excited, live, settings_with())
    assert raised.value.cause == "commissioning.no_trials"


@pytest.mark.slow("services start")
async def test_a_link_that_somebody_else_has_is_named(tmp_path: Path) -> None:
    mode = ("controller.excitation.enabled=true", "controller.excitation.joints=[5]")
    async with plant_server() as server, controller(server, tmp_path, *mode) as live:
        with LiveClient(live.host, live.port) as other:
            await asyncio.to_thread(other.connect)
            with pytest.raises(ConfigurationError) as raised:
                await asyncio.to_thread(excited, live, settings_with())
        assert all(image.valves == (0.0,) * 6 for image in server.written)
    assert raised.value.cause == "commissioning.link_taken"


@pytest.mark.slow("services start")
async def test_a_controller_of_another_configuration_is_named(tmp_path: Path) -> None:
    mode = ("controller.excitation.enabled=true",)
    async with plant_server() as server, controller(server, tmp_path, *mode) as live:
        with pytest.raises(LongreachError) as raised:
            await asyncio.to_thread(excited, live, settings_with("controller.valves.name=other"))
        assert all(image.valves == (0.0,) * 6 for image in server.written)
    assert raised.value.cause == "commissioning.other_session"


ANSWER = {
    "play_mrad": {"wrist3": {"value": -0.11, "std": 0.01}},
    "unseen": {"tilt": "the wall was out of sight"},
    "camera_delay_ms": {"value": 12.0, "std": 0.8},
}


async def left_behind(records: Path, settings: Settings, joint: int) -> None:
    """What a controller leaves in ``records`` once it has tried out ``joint``, in simulated time."""
    world = World(with_excitation(settings, [joint]), 1, RunLog())
    side = world.controller
    program: Any = SimpleNamespace(plan=side.plan, excitation=side.excitation, samples=[])
    basis = basis_of(settings.arm, settings.controller)
    trials = TrialRecords(records, program, basis, EventLog("controller", io.StringIO()))
    world.connect()
    run(world.link.command(CommandCode.ENABLE))
    told = 0
    while not side.excitation.finished(program.plan):
        world.clock.advance()
        program.excitation, program.samples = side.excitation, program.samples + side.samples[told:]
        told = len(side.samples)
        trials.follow()
    await trials.close()


@pytest.mark.slow("services start")
async def test_what_the_vision_pc_let_be_tried_out_is_taken_with_its_plays(tmp_path: Path) -> None:
    assignments = ("controller.excitation.ramps=2", "plant.valves.deadband=0.02")
    overrides = parse_overrides(list(assignments))
    await left_behind(tmp_path, load_settings(CONFIGS, overrides), 5)
    answered = tmp_path / "operation.json"
    answered.write_text(json.dumps({"id": "7", "state": "succeeded", "result": ANSWER}))
    directory = tmp_path / "session"
    request = CommissionRequest(CONFIGS, overrides, ["wrist3"], directory, 1, None, tmp_path, seen=answered)
    assert run_commission(request)  # nobody serves at the configured port
    content = yaml.safe_load((directory / "commissioned.yaml").read_text())
    found = Commissioned.model_validate(content)
    assert found.valves.wrist3.raising.deadband.value == pytest.approx(0.02, rel=0.02)
    assert found.play_mrad.wrist3 is not None
    assert (found.play_mrad.wrist3.value, found.play_mrad.wrist3.std) == (0.11, 0.01)
    assert found.camera_delay_ms is not None
    assert found.camera_delay_ms.value == 12.0


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ("{", "commissioning.bad_session"),
        ('{"cause": "link.camera_silent", "detail": "no picture"}', "commissioning.no_trials"),
        ('{"result": null, "problem": {"cause": "refused.cancelled"}}', "commissioning.no_trials"),
        ('{"result": {"unseen": {}}}', "configuration.missing"),
        ('{"play_mrad": {"elbow": {"value": 1, "std": 1}}}', "configuration.literal_error"),
        ('{"play_mrad": {"slew": {"value": 1, "std": 0}}}', "configuration.greater_than"),
    ],
)
def test_an_answer_that_is_none_is_named(tmp_path: Path, text: str, cause: str) -> None:
    path = tmp_path / "operation.json"
    path.write_text(text)
    with pytest.raises(ConfigurationError) as raised:
        trials_told(path)
    assert raised.value.cause == cause


def test_a_recording_that_is_none_is_named(tmp_path: Path) -> None:
    path = tmp_path / "trial_slew.jsonl"
    path.write_text('{"strokes": [[0]]}\n[1, 2]\n')
    with pytest.raises(ConfigurationError) as raised:
        read_trial(path)
    assert raised.value.cause == "commissioning.bad_recording"
