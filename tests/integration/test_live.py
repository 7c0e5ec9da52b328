"""Three services shown live through one face: every channel that speaks, every figure that is kept."""

import asyncio
import json
from collections.abc import Iterator, Mapping
from contextlib import closing
from typing import Any

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from controller.shell.controller_figures import FIGURES as OF_CONTROLLER
from plant_emulator.shell.plant_figures import FIGURES as OF_PLANT
from testbed.realtime.launch import CONTROLLER, PLANT, VISION
from testbed.realtime.rest_rig import RestRig
from testbed.reporting.console import bars
from tests.foundation.live.viewing import watching
from tests.integration.services import Running, running
from tests.support.paths import ROOT
from tools.dashboard import metrics_of
from vision_pc.shell.rest.metrics import FIGURES as OF_VISION

pytestmark = pytest.mark.realtime("processes")

TABLES = {PLANT: OF_PLANT, CONTROLLER: OF_CONTROLLER, VISION: OF_VISION}
# Told otherwise: shares and percentiles as counters and histograms, words and instants not at all.
DERIVED = ("_percent", "_p50_us", "_p99_us", "_p999_us", "time_ns")
DASHBOARD = ROOT / "grafana" / "longreach.json"


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running(tmp_path_factory.mktemp("live"), foxglove=0) as started:
        face = RestRig(started.launch.rest_url)
        face.wait_healthy(60.0)
        face.close()
        yield started


def work(rig: Running) -> None:
    """A look and a small move."""
    face = RestRig(rig.launch.rest_url)
    with closing(face), bars() as shown, shown.step("working") as bar:
        face.command("enable")
        face.result("look", {}, bar)
        face.result("move", {"offset_base_m": [0.0, 0.03, 0.0]}, bar)


async def test_every_part_is_shown_with_its_schemas(rig: Running) -> None:
    assert rig.launch.foxglove is not None
    async with watching(rig.launch.foxglove) as viewer:
        owners = ("/plant/truth", "/controller/state", "/vision/frame")
        await viewer.until(lambda each: all(topic in each.channels for topic in owners))
        await viewer.subscribe(*viewer.channels)
        await asyncio.to_thread(work, rig)
        spoken = {
            "/plant/truth", "/plant/capture", "/tf_true", "/scene",
            "/camera_true/left/calibration", "/controller/state", "/tf", "/controller/log", "/vision/frame",
            "/vision/observation", "/vision/look", "/vision/reference", "/vision/clock", "/vision/event",
            "/vision/log", "/vision/tf", "/vision/path", "/camera/left/annotations",
            "/camera/left/calibration", "/camera/right/calibration",
        }  # fmt: skip
        assert spoken <= viewer.channels.keys()
        await viewer.until(lambda each: spoken <= {shown.topic for shown in each.shown})
    latest = {shown.topic: shown for shown in viewer.shown}
    frames = {each.child_frame_id for each in latest["/tf_true"].message.transforms}
    assert all(name.startswith("true/") for name in frames), "what is truth says so"
    assert {each.child_frame_id for each in latest["/tf"].message.transforms} >= {"nominal/tool"}
    assert abs(latest["/plant/truth"].log_ns - latest["/controller/state"].log_ns) < 30_000_000_000


def leaves(table: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, float]]:
    for key, value in table.items():
        path = f"{above}{key}"
        if isinstance(value, Mapping):
            yield from leaves(value, f"{path}.")
        elif isinstance(value, int | float):
            yield path, value


def test_every_figure_is_told_once(rig: Running) -> None:
    told = httpx.get(f"http://127.0.0.1:{rig.launch.foxglove}/metrics", timeout=10.0).text
    families = list(text_string_to_metric_families(told))
    names = [family.name for family in families]
    assert len(names) == len(set(names))
    for name, table in TABLES.items():
        assert f"longreach_{name}_resident_memory_bytes" in names, f"{name} tells its figures"
        for figure in table:
            if not figure.label and not figure.path.startswith("look"):
                assert f"longreach_{name}_{figure.name.removesuffix('_total')}" in names, figure.name
    own = rig.face.get("/metrics").text
    said = {family.name for family in text_string_to_metric_families(own)}
    assert said == {name for name in names if name.startswith("longreach_vision_pc_")}, "one way to tell"


def test_the_dashboard_asks_for_nothing_that_is_not_told(rig: Running) -> None:
    told = httpx.get(f"http://127.0.0.1:{rig.launch.foxglove}/metrics", timeout=10.0).text
    samples = {sample.name for family in text_string_to_metric_families(told) for sample in family.samples}
    labelled = {
        f"longreach_{name}_{figure.name}"
        for name, table in TABLES.items()
        for figure in table
        if figure.label
    }
    asked = metrics_of(json.loads(DASHBOARD.read_text()))
    assert len(asked) > 20
    assert asked <= samples | labelled, asked - samples - labelled


def test_no_figure_of_the_statistics_is_left_out(rig: Running) -> None:
    rig.supervisor.stop()
    for name, table in TABLES.items():
        statistics = json.loads(rig.launch.statistics(name).read_text())
        paths = {figure.path for figure in table}
        tables = tuple(f"{figure.path}." for figure in table if figure.label)
        for path, _ in leaves(statistics):
            if not path.endswith(DERIVED) and not path.startswith(tables):
                assert path in paths, f"{name}: {path}"
