"""The controller's recording: what others decode is what the scan saw and commanded."""

import math
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from controller.config import ControllerConfig
from controller.core.scan_program import ScanProgram
from controller.core.scan_types import ScanInput, ScanOutput
from controller.shell.scan_recorder import FILE, FRAMES, LOG, STATE, TOPICS, ScanRecorder
from foundation.configuration import load
from nominal_arm.description import NominalArm
from protocol.errors import ConfigurationError
from protocol.faults import CommandCode
from protocol.process_image import SensorImage
from protocol.reference_messages import Command
from tests.support.pages import page, rows
from tests.support.paths import CONFIGS

CYCLE_NS = 5_000_000
SENSORS = SensorImage(
    plant_cycle=1,
    echo_cycle=0,
    status=0,
    encoder_counts=(0, 100, 200, 300, 400, 500),
    pressures_bar=tuple((10.0 + k, 20.0 + k) for k in range(6)),
    supply_bar=190.0,
    return_bar=5.0,
    oil_temperature_degc=41.5,
)


def config_of(recording_hz: float) -> ControllerConfig:
    """As shipped, but recorded so often."""
    return load(ControllerConfig, CONFIGS / "controller.yaml", {"recording_hz": recording_hz})


def scans(arm: NominalArm, count: int) -> list[tuple[ScanInput, ScanOutput]]:
    """Scans of a controller whose first exchange fails, and that is asked in vain to be enabled."""
    program, made = ScanProgram(arm, config_of(0.0)), []
    for number in range(count):
        now_ns = 1_000_000_000 + number * CYCLE_NS
        requests = (Command(7, CommandCode.ENABLE),) if number == 1 else ()
        inputs = ScanInput(now_ns, now_ns, 0.005, SENSORS if number else None, requests, True)
        made.append((inputs, program.scan(inputs)))
    return made


def decoded(path: Path) -> dict[str, list[Any]]:
    """Messages by topic, as the library of the format's makers decodes them."""
    found: dict[str, list[Any]] = {STATE: [], FRAMES: [], LOG: []}
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, _, said in reader.iter_decoded_messages():
            found[channel.topic].append(said)
    return found


def test_others_decode_what_every_scan_saw_and_commanded(arm: NominalArm, tmp_path: Path) -> None:
    made = scans(arm, 6)
    with closing(ScanRecorder(tmp_path, arm, config_of(200.0))) as recorder:
        for inputs, output in made:
            recorder.scan(inputs, output)
    found = decoded(tmp_path / FILE)
    for (inputs, output), said in zip(made, found[STATE], strict=True):
        view = output.view
        assert (said.cycle, said.fault, said.group_state) == (view.cycle, view.fault, view.group_state)
        assert [said.q_meas_slew_rad, said.q_meas_wrist3_rad] == [view.q_meas[0], view.q_meas[5]]
        assert [said.valve_slew, said.q_cmd_tilt_rad] == [view.valves[0], view.q_cmd[2]]
        assert [said.X_BT_p_x_m, said.X_BT_cmd_q_w] == [view.X_BT.p_m[0], view.X_BT_cmd.q_wxyz[0]]
        assert said.HasField("pressure_slew_a_bar") == (inputs.sensors is not None)
    assert (said.pressure_lift_b_bar, said.oil_temperature_degc) == (21.0, 41.5)
    for (_, output), frames in zip(made, found[FRAMES], strict=True):
        tool, commanded = frames.transforms
        assert (tool.child_frame_id, commanded.child_frame_id) == ("nominal/tool", "nominal/tool_commanded")
        p, q = tool.translation, tool.rotation
        assert (p.x, p.y, p.z) == output.view.X_BT.p_m
        assert math.isclose(q.w**2 + q.x**2 + q.y**2 + q.z**2, 1.0)
    told = [event.name for _, output in made for event in output.events]
    assert told
    assert [line.message.partition(":")[0] for line in found[LOG]] == told


def test_fewer_scans_are_recorded_when_asked_for_and_all_events(arm: NominalArm, tmp_path: Path) -> None:
    made = scans(arm, 40)
    with closing(ScanRecorder(tmp_path, arm, config_of(50.0))) as recorder:
        for inputs, output in made:
            recorder.scan(inputs, output)
    found = decoded(tmp_path / FILE)
    assert [said.cycle for said in found[STATE]] == list(range(4, 41, 4))
    assert len(found[LOG]) == sum(len(output.events) for _, output in made)


def test_the_page_tells_of_every_topic() -> None:
    table = rows(page("recording.md"), "topic | schema")
    assert {name: cells[0].strip("`") for name, cells in table.items()} == {
        topic.name: topic.format.schema for topic in TOPICS
    }


def test_an_existing_recording_is_refused(arm: NominalArm, tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"precious")
    with pytest.raises(ConfigurationError, match=FILE) as refused:
        ScanRecorder(tmp_path, arm, config_of(50.0))
    assert refused.value.cause == "configuration.recording"
    assert (tmp_path / FILE).read_bytes() == b"precious"
