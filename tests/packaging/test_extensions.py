"""A small installed package adds a program and a disturbance; broken ones are left out."""

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from typer.testing import CliRunner

import longreach
from laboratory.campaigns.campaign import CampaignRequest
from laboratory.experiments.positioning import programs
from laboratory.experiments.positioning.programs import ProgramsSettings, programs_tasks
from plant_emulator.core import layout as col
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.fault_execution import carry_out, fault_state
from plant_emulator.core.faults.schedule import NEVER_NS, FaultOrder, FaultState, MendOrder, message_with
from plant_emulator.core.plant import Plant
from plant_emulator.shell import fault_api, fault_desk
from protocol.errors import ConfigurationError, RequestRefused
from testbed.cli.main import app
from testbed.scenarios.scenario import fault_orders
from tests.plant_emulator.camera.camera_world import scene_config
from tests.plant_emulator.plant_world import plant_config
from tests.support.pages import page
from tests.support.paths import CONFIGS
from tests.vision_pc.synthetic_station import bench
from vision_pc.shell import installed_programs
from vision_pc.shell.rest.api import create_app

PAGE = page("how_to/install_your_own.md")
(PYPROJECT,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
(MODULE,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
CACHES = (installed_programs.installed_programs, fault_desk.installed_faults)


def entry_points(pyproject: str) -> str:
    """What an installer writes of ``pyproject`` into entry_points.txt."""
    return re.sub(
        r'\[project\.entry-points\."(.*)"\]', r"[\1]", pyproject[pyproject.index("[project.entry") :]
    )


def install(site: Path, name: str, points: str, **modules: str) -> None:
    """What pip leaves of a package that is pure Python."""
    info = site / f"{name.replace('-', '_')}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(points.replace('"', ""))
    for module, text in modules.items():
        (site / f"{module}.py").write_text(text)


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of installed packages, with the page's."""
    install(tmp_path, "my-crane", entry_points(PYPROJECT), my_crane=MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    for cache in CACHES:
        cache.cache_clear()
    yield tmp_path
    for cache in CACHES:
        cache.cache_clear()
    for module in ("my_crane", "broken_crane", "other_crane"):
        sys.modules.pop(module, None)


@pytest.fixture
def broken(site: Path) -> Path:
    """And one in which everything is wrong."""
    points = {
        "programs": {"nudge": "other_crane:X", "fails": "broken_crane:X", "look": "other_crane:X",
                     "absent": "other_crane:ABSENT", "number": "other_crane:X",
                     "other-name": "my_crane:NUDGE"},
        "disturbances": {"payload_drop": "other_crane:X", "not_one": "other_crane:X",
                         "plain": "other_crane:K",
                         "other_kind": "my_crane:SwingingLoad"},
    }  # fmt: skip
    text = "".join(
        f"[longreach.{group}]\n" + "".join(f"{name} = {place}\n" for name, place in some.items())
        for group, some in points.items()
    )
    install(site, "other-crane", text, other_crane="X = 3\nclass K: ...\n", broken_crane="1 / 0\n")
    return site


def listed(tmp_path: Path) -> tuple[int, dict[str, dict[str, Any]]]:
    """Exit status and rows of `longreach programs`, by kind and name and package."""
    file = tmp_path / "programs.json"
    done = CliRunner().invoke(app, ["programs", "--json", str(file)])
    told = json.loads(file.read_text())
    rows = {kind: {f"{row['name']} of {row['package']}": row for row in told[kind]} for kind in told}
    return done.exit_code, rows


def test_what_a_package_adds_is_listed_with_ours(site: Path, tmp_path: Path) -> None:
    status, rows = listed(tmp_path)
    assert status == 0
    assert rows["programs"]["nudge of my-crane"]["shows"] == "Move the tool up a little"
    assert rows["disturbances"]["swinging_load of my-crane"]["shows"].startswith("The load swings")
    assert {"look of longreach", "move of longreach"} <= set(rows["programs"])


CAUSES = {
    ("programs", "nudge of my-crane"): "extension.name_taken: other-crane has one of this name too",
    ("programs", "nudge of other-crane"): "extension.name_taken: my-crane has one of this name too",
    ("programs", "look of other-crane"): "extension.name_taken: Longreach's own has this name",
    ("programs", "fails of other-crane"): "extension.not_loaded: broken_crane:X: ZeroDivisionError",
    ("programs", "absent of other-crane"): "extension.not_loaded: other_crane:ABSENT: AttributeError",
    ("programs", "number of other-crane"): "extension.wrong_type: wanted a vision_pc.",
    ("programs", "other-name of other-crane"): "extension.wrong_name: the program calls itself 'nudge'",
    ("disturbances", "payload_drop of other-crane"): "extension.name_taken: Longreach's own",
    ("disturbances", "not_one of other-crane"): "extension.wrong_type: wanted a class",
    ("disturbances", "plain of other-crane"): "extension.wrong_type: K is no plant_emulator.",
    ("disturbances", "other_kind of other-crane"): "extension.wrong_name: its kind is 'swinging_load'",
}


def test_what_is_broken_or_clashes_is_told_and_the_rest_goes_on(broken: Path, tmp_path: Path) -> None:
    status, rows = listed(tmp_path)
    assert status == 1
    troubles = {(kind, name): row["trouble"] for kind in rows for name, row in rows[kind].items()}
    assert {place for place, trouble in troubles.items() if trouble} == set(CAUSES)
    for place, cause in CAUSES.items():
        assert troubles[place].startswith(cause), place
    assert not rows["programs"]["look of longreach"]["trouble"]
    assert not rows["disturbances"]["swinging_load of my-crane"]["trouble"]


def test_asked_for_by_name_a_broken_one_says_why(broken: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"no such kind; known: .*extension.wrong_type: not_one of"):
        fault_orders(["not_one"])


@pytest.mark.slow("pip installs an extension")
def test_lockstep_runs_its_program_under_its_disturbance(broken: Path) -> None:
    (broken / "other_crane-1.0.dist-info" / "entry_points.txt").write_text(
        "[longreach.programs]\nx = broken_crane:X\n"
    )
    with longreach.lockstep(config_dir=CONFIGS, set={"plant.payload.mass_kg": 100}) as rig:
        rig.enable()
        with pytest.raises(RequestRefused, match="x of other-crane: broken_crane:X: ZeroDivisionError"):
            rig.run("x")
        (order,) = fault_orders(["swinging_load,share=0.1,period_s=1"])
        rig.plant.inject(order.fault)
        before = rig.truth.X_BT[2, 3]
        assert rig.run("nudge", up_mm=30) == pytest.approx(0.03, abs=1e-2)
        assert rig.truth.X_BT[2, 3] - before == pytest.approx(0.03, abs=1e-2)
        assert rig.truth.faults == ("swinging_load",)
        loads = {round(truth.payload_kg) for truth in rig.lockstep_rig.world.truths}
    assert min(loads) == 90
    assert max(loads) == 110


def test_effects_are_asked_again_as_often_as_wanted(site: Path) -> None:
    (order,) = fault_orders(["swinging_load,share=0.5,period_s=1,start_after_s=0.1,duration_s=0.5"])
    plant = Plant(plant_config(payload={"mass_kg": 100.0}), seed=1)
    plant.inject(order.fault, 100_000_000, 500_000_000)
    loads = []
    for _ in range(14):
        plant.advance(50_000_000)
        loads.append(plant.truth().payload_kg)
    swing = 100.0 * (1.0 + 0.5 * np.sin(2.0 * np.pi * np.arange(0.0, 0.5, 0.05)))
    assert loads == pytest.approx([100.0, *swing, 100.0, 100.0, 100.0])
    assert plant.faults.next_ns() == NEVER_NS


@pytest.mark.parametrize(
    ("method", "told"),
    [
        ("load_kg(self, elapsed_s, load_kg): return -1.0", "load_kg gave -1.0: wanted 0 to 1000"),
        ("encoder_shift(self, elapsed_s): return [0.0] * 5", "wanted six numbers in -1 to 1"),
        ("valve_speed(self, elapsed_s): return [2.0] * 6", "wanted six numbers in 0 to 1"),
        ("pump_runs(self, elapsed_s): return 1 / 0", "ZeroDivisionError"),
    ],
)
def test_effects_that_no_plant_takes_are_refused_before_they_are_let_loose(method: str, told: str) -> None:
    text = (
        "from plant_emulator.core.faults.kinds import OwnFault\nclass Bad(OwnFault):\n    kind: str = 'bad'\n"
    )
    made: dict[str, Any] = {}
    exec(f"{text}    def {method}\n", made)
    plant = Plant(plant_config(), seed=1)
    with pytest.raises(RequestRefused, match=re.escape(told)) as refused:
        plant.inject(made["Bad"]())
    assert refused.value.cause == "refused.disturbance"
    assert plant.faults.all() == ()


def test_valves_pump_and_encoders_obey_too() -> None:
    text = """
from plant_emulator.core.faults.kinds import OwnFault
class Worn(OwnFault):
    kind: str = "worn"
    def encoder_shift(self, elapsed_s): return [0.0, elapsed_s * 0.1, 0.0, 0.0, 0.0, 0.0]
    def valve_speed(self, elapsed_s): return [1.0, 0.5, 0.0, 1.0, 1.0, 1.0]
    def pump_runs(self, elapsed_s): return False
"""
    made: dict[str, Any] = {}
    exec(text, made)
    broken, whole = (Plant(plant_config(), seed=1) for _ in range(2))
    broken.inject(made["Worn"]())
    for plant in (broken, whole):
        plant.advance(100_000_000)
    omega = [plant.model.actuators[:, col.A_OMEGA] for plant in (broken, whole)]
    np.testing.assert_allclose(omega[0] / omega[1], [1.0, 0.5, 0.0, 1.0, 1.0, 1.0])
    assert broken.truth().supply < 0.9 * whole.truth().supply
    shift = broken.read().encoder_counts[1] - whole.read().encoder_counts[1]
    assert shift == pytest.approx(0.01 * 131072 / (2.0 * np.pi), abs=25)  # and what the pump's loss lets sink


async def test_the_api_serves_its_program_and_the_console_is_told(site: Path) -> None:
    async with bench() as made:
        served = create_app(made.station, made.operations, installed_programs.every_program())
        made.client = httpx.AsyncClient(transport=httpx.ASGITransport(app=served), base_url="http://vision")
        async with made.client:
            told = (await made.client.get("/programs")).json()
            assert [row["name"] for row in told if row["own"]] == ["nudge"]
            await made.post("/enable")
            too_far = await made.post("/operations/nudge", {"up_mm": 101.0})
            assert (too_far.status_code, too_far.json()["cause"]) == (422, "request.invalid")
            ended = await made.run("nudge", {"up_mm": 30.0})
            assert ended["result"]["up_mm"] == pytest.approx(30.0, abs=1.0)


class NearDesk:
    """A plant without a process in between; what would cross is JSON all the same."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant

    async def state(self) -> FaultState:
        return FaultState.model_validate_json(fault_state(self._plant).model_dump_json())

    async def ask(self, order: FaultOrder | MendOrder) -> list[dict[str, Any]]:
        kind = message_with(fault_desk.own_kinds())
        message = kind.model_validate_json(kind(number=1, order=order).model_dump_json())
        answer = carry_out(message, self._plant, Scene(scene_config()).cover).answer
        assert answer is not None
        assert not answer.cause
        return list(answer.concerned)


async def test_the_fault_api_serves_its_disturbance(site: Path) -> None:
    plant = Plant(plant_config(), seed=1)
    served = fault_api.create_app(NearDesk(plant), True)
    transport = httpx.ASGITransport(app=served)
    async with httpx.AsyncClient(transport=transport, base_url="http://plant") as client:
        kinds = {row["kind"]: row for row in (await client.get("/faults/kinds")).json()}
        assert kinds["swinging_load"]["schema"]["properties"]["share"]["maximum"] == 0.5
        wrong = await client.post("/faults", json={"fault": {"kind": "swinging_load", "share": 0.6}})
        assert (wrong.status_code, wrong.json()["cause"]) == (422, "refused.fault_parameter")
        done = await client.post("/faults", json={"fault": {"kind": "swinging_load", "share": 0.3}})
        assert done.status_code == 201
        assert done.json()["fault"] == {"kind": "swinging_load", "share": 0.3, "period_s": 2.0}
        ours = await client.post("/faults", json={"fault": {"kind": "payload_change", "mass_kg": 20.0}})
        assert ours.status_code == 201
    assert plant.truth().faults == ("payload_change", "swinging_load")


def test_rows_are_evidence_of_the_package_s_sources(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programs, "sources_hash", lambda module: f"hash of {module}")
    request = CampaignRequest(CONFIGS, site / "rows")
    ours, own = (
        programs_tasks(request, ProgramsSettings(program=[name]))
        for name in ("look-then-move", "nudge,up_mm=20")
    )
    assert "sources of nudge" not in ours[0]
    assert "looks" in ours[0]
    assert own[0]["sources of nudge"] == "hash of my_crane"
