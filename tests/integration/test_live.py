"""Three services shown live through one face: every part speaks, every figure that is kept is told."""

import asyncio
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from controller.shell.controller_metrics import METRICS as OF_CONTROLLER
from plant_emulator.shell.plant_metrics import METRICS as OF_PLANT
from testbed.realtime.launch import CONTROLLER, PLANT, VISION
from tests.foundation.live.viewing import WITHIN_S, watching
from tests.integration.services import Running, running
from tests.support.grafana import metrics
from vision_pc.shell.rest.metrics import METRICS as OF_VISION

pytestmark = pytest.mark.processes

TABLES = {PLANT: OF_PLANT, CONTROLLER: OF_CONTROLLER, VISION: OF_VISION}
# Told otherwise: shares and percentiles as counters and histograms, words and instants not at all.
DERIVED = ("_percent", "_p50_us", "_p99_us", "_p999_us", "time_ns")
# Not known before a look, a picture, or without a session: nothing is told then.
NOT_ALWAYS = ("look.", "controller.", "reference_link.", "camera.", "oil_", "supply_")


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running(tmp_path_factory.mktemp("live"), foxglove=0) as started:
        yield started


@pytest.mark.slow("three services start")
async def test_every_part_is_shown_with_its_schemas(rig: Running) -> None:
    assert rig.launch.foxglove is not None
    async with watching(rig.launch.foxglove) as viewer:
        owners = ("/plant/truth", "/controller/state", "/vision/frame")
        await viewer.until(lambda each: all(topic in each.channels for topic in owners))
        await viewer.subscribe(*viewer.channels)
        spoken = {
            "/plant/truth", "/plant/capture", "/tf_true", "/scene", "/camera_true/left/calibration",
            "/controller/state", "/tf",
        }  # fmt: skip
        await viewer.until(lambda each: spoken <= {shown.topic for shown in each.shown})
    latest = {shown.topic: shown.message for shown in viewer.shown}
    frames = {each.child_frame_id for each in latest["/tf_true"].transforms}
    assert frames
    assert all(name.startswith("true/") for name in frames), "what is truth says so"
    assert latest["/plant/truth"].oil_temperature_degc > 0.0
    assert len(latest["/scene"].entities) > 5


@pytest.mark.slow("three services start")
async def test_a_look_is_shown_as_vision_told_it(rig: Running) -> None:
    assert rig.launch.foxglove is not None
    async with (
        watching(rig.launch.foxglove) as viewer,
        httpx.AsyncClient(base_url=rig.launch.rest_url) as rest,
    ):
        topics = ("/vision/frame", "/vision/observation", "/vision/look")
        await viewer.until(lambda each: all(topic in each.channels for topic in topics))
        await viewer.subscribe(*topics)
        answer = await looked(rest)
        await viewer.until(lambda each: set(topics) <= {shown.topic for shown in each.shown})
    shown = {topic: [each.message for each in viewer.shown if each.topic == topic] for topic in topics}
    look, told = shown["/vision/look"][-1], answer["result"]
    assert [look.p_CM_x_m, look.p_CM_y_m, look.p_CM_z_m] == pytest.approx(told["X_CM"]["p_m"], abs=1e-12)
    seen = {each.capture_ns: each for each in shown["/vision/observation"]}
    frames = [frame for frame in shown["/vision/frame"] if frame.capture_ns in seen]
    assert frames
    assert all((frame.width, frame.height) == (1280, 720) for frame in frames)
    assert all(seen[frame.capture_ns].frame_id == frame.frame_id for frame in frames)


async def looked(rest: httpx.AsyncClient) -> dict[str, Any]:
    """A look that succeeded, once camera and controller are there."""
    waiting = {"Prefer": f"wait={WITHIN_S:g}"}
    async with asyncio.timeout(2.0 * WITHIN_S):
        while True:
            sent = await rest.post("/operations/look", json={}, headers=waiting, timeout=WITHIN_S + 10.0)
            answer: dict[str, Any] = sent.json()
            if answer.get("state") == "succeeded":
                return answer
            await asyncio.sleep(0.5)


async def told_by_all(rig: Running) -> dict[str, set[str]]:
    """Samples of each family, once all three tell theirs."""
    async with httpx.AsyncClient(timeout=20.0) as asked, asyncio.timeout(WITHIN_S):
        while True:
            answer = await asked.get(f"http://127.0.0.1:{rig.launch.foxglove}/metrics")
            families = list(text_string_to_metric_families(answer.text))
            found = {family.name: {sample.name for sample in family.samples} for family in families}
            assert len(found) == len(families), "each name once"
            if all(f"longreach_{name}_live_dropped" in found for name in TABLES):
                return found
            await asyncio.sleep(0.2)


async def test_every_figure_is_told(rig: Running) -> None:
    families = await told_by_all(rig)
    for name, table in TABLES.items():
        for figure in table:
            if not figure.label and not figure.path.startswith(NOT_ALWAYS):
                assert f"longreach_{name}_{figure.name.removesuffix('_total')}" in families, figure.name
    histograms = {name for samples in families.values() for name in samples if name.endswith("_bucket")}
    asked = {name for name in metrics() if name.endswith("_bucket")}
    assert asked
    assert asked <= histograms, "the dashboard asks for what is told"
