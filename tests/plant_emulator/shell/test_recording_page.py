"""docs/recording.md says what the code does: channels, fields and their shapes."""

import contextlib
import io
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from foundation.configuration import load
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.faults.kinds import SupplyLost
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import PlantTruth
from plant_emulator.shell.scene_messages import drawing
from plant_emulator.shell.truth_message import _COLUMNS, _SCALARS, HOLES, TruthMessage
from plant_emulator.shell.truth_recorder import TOPICS, TruthRecorder
from tests.plant_emulator.plant_world import Driver, plant_config
from tests.support.pages import page, rows
from tests.support.paths import CONFIGS

PAGE = page("recording.md")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A short recording of a plant that loses its supply."""
    plant = Plant(plant_config(), seed=1)
    plant.inject(SupplyLost(), start_ns=20_000_000)
    drawn = drawing(load(SceneConfig, CONFIGS / "scene.yaml"), plant.chain, 0)
    recorder = TruthRecorder(tmp_path / "truth.mcap", {}, drawn, {"id": "7"})
    driver = Driver(plant)
    for number in range(4):
        driver.run(0.01)
        recorder.truth(plant.truth(), plant.time_ns, plant.links())
        recorder.capture(plant.truth(), plant.time_ns, number)
    recorder.event({"event": "status", "status": 1}, plant.time_ns, plant.time_ns)
    for change in plant.faults.changes:
        recorder.fault(change, plant.time_ns)
    recorder.close()
    return tmp_path / "truth.mcap"


def test_every_field_of_the_truth_is_there_with_its_shape() -> None:
    table = rows(PAGE, "field | shape")
    assert tuple(table) == PlantTruth._fields
    truth = Plant(plant_config(), seed=1).truth()
    for name, (shape, told) in table.items():
        columns = _COLUMNS.get(name) or (_SCALARS.get(name, name),)
        message = f"`{columns[0]}`" + (f" … `{columns[-1]}`" if len(columns) > 1 else "")
        assert told.partition(":")[0] == message
        value = getattr(truth, name)
        if name == "faults":
            assert shape == "any"
        else:
            assert shape == ("×".join(map(str, np.shape(value))) or "–"), name


def test_every_channel_is_there_with_its_schema(recording: Path) -> None:
    table = rows(PAGE, "channel")
    assert list(table) == [topic.name for topic in TOPICS]
    with recording.open("rb") as stream:
        reader = make_reader(stream)
        found = {channel.topic: schema.name for schema, channel, _ in reader.iter_messages() if schema}
        metadata = {record.name: set(record.metadata) for record in reader.iter_metadata()}
    assert found == {topic: cells[0].strip("`") for topic, cells in table.items()}
    assert metadata == {"run": {"configuration"}, "session": {"id"}}


def test_the_ten_lines_run(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = PAGE.partition("```python\n")[2].partition("```")[0]
    assert len([line for line in code.splitlines() if line]) == 9
    monkeypatch.chdir(recording.parent)
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(code, {})
    assert "8 truths" in said.getvalue()
    assert "supply_lost {'kind': 'supply_lost'} 20000000 None" in said.getvalue()
    assert said.getvalue().endswith("complete\n")


def test_a_capture_tells_where_the_drill_holes_are_in_the_camera(tmp_path: Path) -> None:
    plant = Plant(plant_config(), seed=1)
    holes = [
        {"centre_m": (-0.2, 0.1), "diameter_mm": 45.0, "depth_m": 0.5},
        {"centre_m": (0.1, 0.0), "diameter_mm": 45.0},
    ]
    scene = load(SceneConfig, CONFIGS / "scene.yaml", {"wall": {"drill_holes": holes, "undulation_mm": 5.0}})
    with contextlib.closing(
        TruthRecorder(tmp_path / "t.mcap", {}, drawing(scene, plant.chain, 0))
    ) as recorder:
        recorder.truth(plant.truth(), 1)
        recorder.capture(plant.truth(), 2, 7)
    with (tmp_path / "t.mcap").open("rb") as stream:
        messages = [
            (channel.topic, message.data) for _, channel, message in make_reader(stream).iter_messages()
        ]
    told = {
        topic: np.array(getattr(TruthMessage.FromString(data), HOLES)).reshape(-1, 3)
        for topic, data in messages
        if topic in ("/plant/truth", "/plant/capture")
    }
    truth = plant.truth()
    X_CO = np.linalg.inv(truth.X_WC) @ truth.X_WO
    in_O = (told["/plant/capture"] - X_CO[:3, 3]) @ X_CO[:3, :3]
    assert np.allclose(in_O[:, :2], [[-0.2, 0.1], [0.1, 0.0]], atol=1e-9)
    assert np.all(np.abs(in_O[:, 2]) <= 0.005)
    assert np.ptp(in_O[:, 2]) > 1e-4  # the wall rises and falls
    assert len(told["/plant/truth"]) == 0
