"""Arms by name: layers of configuration, what `arm check` finds, and `--arm` on every command."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import typer

import longreach
from foundation.configuration import laid_over, layers, parse_overrides
from protocol.errors import ConfigurationError
from testbed.arms import check_arm
from testbed.cli.main import app
from testbed.scenarios.arms import arm_directory, arm_names, arm_overrides
from testbed.scenarios.scenario import load_scenario, load_settings
from tests.support.commands import ran
from tests.support.paths import CONFIGS
from tests.testbed.cli.test_vocabulary import walked

CRANE = CONFIGS / "arms/long_crane"


def written(directory: Path, **files: str) -> Path:
    directory.mkdir(parents=True)
    for stem, text in files.items():
        (directory / f"{stem}.yaml").write_text(text, encoding="utf-8")
    return directory


# Layers


def test_an_upper_directory_is_laid_key_by_key_over_the_lower(tmp_path: Path) -> None:
    low = written(tmp_path / "low", plant="a: {b: 1, c: 2}\nd: [1, 2]\n")
    middle = written(tmp_path / "middle", base="over: ../low\n")
    top = written(tmp_path / "top", base="over: ../middle\n", plant="a: {b: 5}\nd: [3]\n")
    assert layers(top) == [low, middle, top]
    content, where = laid_over(top, "plant.yaml")
    assert content == {"a": {"b": 5, "c": 2}, "d": [3]}
    assert where == f"{top / 'plant.yaml'} over {low / 'plant.yaml'}"


def test_wrong_bases_are_refused(tmp_path: Path) -> None:
    circle = written(tmp_path / "circle", base="over: .\n")
    with pytest.raises(ConfigurationError, match="over each other") as refused:
        layers(circle)
    assert refused.value.cause == "configuration.base_circle"
    with pytest.raises(ConfigurationError, match=r"no directory .*nowhere"):
        layers(written(tmp_path / "lost", base="over: ../nowhere\n"))


def test_a_scenario_is_laid_over_its_namesake() -> None:
    shared, own = (load_scenario(directory, "standard").draws for directory in (CONFIGS, CRANE))
    assert own.keys() == shared.keys()
    differing = {key for key in own if own[key] != shared[key]}
    assert differing == {"scene.object_of_interest.position_m"}


# Names


def test_an_arm_is_found_by_name_or_directory(tmp_path: Path) -> None:
    assert {"default", "long_crane", "rock_breaker"} <= set(arm_names(CONFIGS))
    assert arm_directory(CONFIGS, "long_crane") == CRANE
    assert arm_directory(CONFIGS, f"{tmp_path}/") == tmp_path
    with pytest.raises(ConfigurationError, match="no directory"):
        arm_directory(CONFIGS, f"{tmp_path}/none")


@pytest.mark.parametrize("name", ["default", "long_crane", "rock_breaker"])
def test_its_overrides_make_the_same_machine_as_its_directory(name: str) -> None:
    by_overrides = load_settings(CONFIGS, arm_overrides(CONFIGS, name))
    assert by_overrides == load_settings(arm_directory(CONFIGS, name), {})


# `arm check`


@pytest.mark.parametrize("name", arm_names(CONFIGS))
def test_the_shipped_arms_are_right(name: str) -> None:
    findings = check_arm(load_settings(arm_directory(CONFIGS, name), {}))
    assert [finding for finding in findings if finding.verdict != "ok"] == []


@pytest.mark.parametrize(
    ("assignment", "name"),
    [
        ("plant.geometry.lift_pivot_m=[-0.19, 0.95]", "lift pivot, up"),
        ("plant.geometry.tilt_pivot_m=[1.80, 0.1]", "boom"),
        ("plant.geometry.tilt_pivot_m=[1.59, 0.16]", "zero of lift"),
        ("plant.geometry.boom_tip_m=[2.0, 0.19]", "boom tip, up"),
        ("plant.geometry.telescope_m=1.2", "forearm with telescope"),
        ("plant.geometry.tool_length_m=0.45", "tool"),
        ("plant.actuators.lift.cylinder.base_m=1.05", "lift's long side"),
        ("plant.actuators.tilt.cylinder.angle_rad=0.45", "tilt's angle offset"),
        ("plant.actuators.lift.rated_flow_l_min=60", "lift, full spool, extend"),
        ("plant.actuators.slew.rated_flow_l_min=55", "slew, full spool, turn"),
        ("plant.actuators.lift.cylinder.stroke_m=0.45", "lift's range"),
        ("plant.masses.boom=[{mass_kg: 98000.0, from_m: [0, 0], to_m: [1, 0]}]", "units"),
        ("plant.start_pose_deg=[0.0, 50.0, -75.0, 0.0, -3.0, 0.0]", "start, singularities"),
        ("plant.start_pose_deg=[-118.0, 50.0, -75.0, 0.0, -25.0, 0.0]", "start, slew"),
        ("arm.workspace.x_m=[0.5, 3.0]", "start, workspace"),
        ("scene.object_of_interest.position_m=[9.0, 0.2, 1.0]", "object, reach"),
    ],
)
def test_each_wrong_number_has_its_line(assignment: str, name: str) -> None:
    findings = check_arm(load_settings(CONFIGS, parse_overrides([assignment])))
    wrong = {finding.name: finding for finding in findings if finding.verdict != "ok"}
    assert name in wrong
    assert wrong[name].advice


def test_a_vane_drawn_as_a_cylinder_is_told() -> None:
    rotary = {"name": "lift", "kind": "rotary", "speed_rad_s": 1.0}
    drives = [drive.model_dump() for drive in load_settings(CONFIGS, {}).arm.drives]
    drives[1] = rotary
    wrong = [f for f in check_arm(load_settings(CONFIGS, {"arm": {"drives": drives}})) if f.verdict != "ok"]
    assert [finding.name for finding in wrong] == ["lift's drive"]


def test_a_file_that_cannot_be_read_is_a_finding(tmp_path: Path) -> None:
    own = written(tmp_path / "own", base=f"over: {CONFIGS}\n", plant="watchdog_ms: -1\n")
    told = tmp_path / "found.json"
    ran("arm", "check", f"{own}/", "--config-dir", CONFIGS, "--json", told, status=1)
    (finding,) = json.loads(told.read_text())["findings"]
    assert finding["name"] == "plant.yaml"
    assert "watchdog_ms" in finding["found"]


# Commands


def test_an_arm_that_was_begun_is_the_one_it_was_begun_with(tmp_path: Path) -> None:
    own = tmp_path / "own"
    ran("arm", "new", own, "--like", "long_crane", "--config-dir", CONFIGS)
    made, like = load_settings(own, {}), load_settings(CRANE, {})
    assert made.arm.name == "own"
    assert made._replace(arm=like.arm) == like
    assert made.arm.model_copy(update={"name": like.arm.name}) == like.arm
    ran("arm", "new", own, "--config-dir", CONFIGS, status=2)
    (own / "plant.yaml").write_text("geometry: {telescope_m: 2.0}\n", encoding="utf-8")
    ran("arm", "check", f"{own}/", "--config-dir", CONFIGS, status=1)


def test_the_option_takes_the_place_of_the_directory(tmp_path: Path) -> None:
    made = tmp_path / "crane.xml"
    ran("export", "urdf", "--out", made, "--arm", "long_crane", "--config-dir", CONFIGS)
    assert "long-crane" in made.read_text(encoding="utf-8")


@pytest.mark.slow("a whole demonstration in lockstep")
def test_every_command_that_reads_a_configuration_takes_an_arm() -> None:
    root = typer.main.get_command(app)
    found = walked(root, (), typer.Context(root))
    reads = {path: command for path, command in found if "config_dir" in names(command)}
    assert len(reads) > 15
    without = {path for path, command in reads.items() if not {"arm", "chosen"} & names(command)}
    assert without == set()


def names(command: Any) -> set[str]:
    return {parameter.name for parameter in command.params}


def test_the_interface_for_python_takes_an_arm() -> None:
    assert longreach.arm("rock_breaker", config_dir=CONFIGS).description.name.startswith("rock-breaker")
    crane = longreach.plant(arm="long_crane", config_dir=CONFIGS)
    assert crane.truth.X_BT[0, 3] == pytest.approx(8.3, abs=0.2)


def test_a_broken_arm_is_named_and_the_others_are_listed(tmp_path: Path) -> None:
    shutil.copytree(CONFIGS, tmp_path / "configs")
    (tmp_path / "configs/arms/rock_breaker/plant.yaml").write_text("valves: [")
    done = ran("arm", "list", "--config-dir", tmp_path / "configs", "--json", tmp_path / "arms.json")
    found = json.loads((tmp_path / "arms.json").read_text())
    listed = {arm["arm"] for arm in found["arms"]}
    assert listed >= {"default", "long_crane"}
    assert "rock_breaker" not in listed
    assert "rock_breaker/plant.yaml" in "".join(found["broken"])
    assert "left out: " in done.output
