"""The containers: what the compose file promises and, where an engine runs, the tool at the object."""

import json
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import yaml

from foundation.configuration import parse_overrides
from plant_emulator.core.truth import tool_error
from plant_emulator.shell.recording import read_truth
from testbed.realtime.launch import free_port
from testbed.realtime.rest_rig import RestRig
from testbed.reporting.console import bars
from tests.integration.services import ROOT

PROJECT = "longreach-test"
LIMIT_M = 0.005
CLEARANCE_M = 0.10
TOKENS = "/var/lib/longreach-tokens"


def compose_command() -> list[str] | None:
    """Compose as it is called here, v1 or v2; None where there is none or no engine answers."""
    if shutil.which("docker") is None or subprocess.run(["docker", "info"], capture_output=True).returncode:
        return None
    if shutil.which("docker-compose"):
        return ["docker-compose"]
    v2 = subprocess.run(["docker", "compose", "version"], capture_output=True)
    return ["docker", "compose"] if v2.returncode == 0 else None


def document() -> dict[str, Any]:
    return dict(yaml.safe_load((ROOT / "docker-compose.yml").read_text()))


def own_document() -> dict[str, Any]:
    """What is started without a profile."""
    compose = document()
    services = {name: each for name, each in compose["services"].items() if "profiles" not in each}
    return compose | {"services": services}


def test_only_the_rest_port_is_published_and_only_on_loopback() -> None:
    services = own_document()["services"]
    assert set(services) == {"tokens", "plant", "controller", "vision"}
    published = {name: service["ports"] for name, service in services.items() if "ports" in service}
    assert published == {"vision": ["127.0.0.1:${LONGREACH_PORT:-8000}:8000"]}


def test_fieldbus_and_camera_are_on_an_internal_network() -> None:
    compose = document()
    assert compose["networks"]["machine"] == {"internal": True}
    assert compose["services"]["plant"]["networks"] == ["machine"]
    assert compose["services"]["controller"]["networks"] == ["machine"]


def test_the_rest_port_wants_the_tokens_that_are_made_at_the_first_start() -> None:
    services = own_document()["services"]
    made = [word for word in services["tokens"]["command"] if word.startswith(TOKENS)]
    assert made == [f"{TOKENS}/look", f"{TOKENS}/operate"]
    for role, path in zip(("look", "operate"), made, strict=True):
        assert f"vision.api.tokens.{role}.file={path}" in services["vision"]["command"]
    assert services["vision"]["healthcheck"]["test"][-2:] == ["--token-file", made[0]]
    assert services["tokens"]["network_mode"] == "none"
    assert f"tokens:{TOKENS}:ro" in services["vision"]["volumes"]
    assert not any("tokens" in str(services[name].get("volumes")) for name in ("plant", "controller"))


def test_each_service_is_watched_and_waits_for_those_it_needs() -> None:
    services = own_document()["services"]
    first = services.pop("tokens")  # it ends before the others begin
    assert "healthcheck" not in first
    assert all(service["healthcheck"]["test"][0] == "CMD" for service in services.values())
    assert services["plant"].pop("depends_on") == {"tokens": {"condition": "service_completed_successfully"}}
    assert set(services["controller"]["depends_on"]) == {"plant"}
    expected = services["vision"]["depends_on"]
    assert expected.pop("tokens") == {"condition": "service_completed_successfully"}
    assert set(expected) == {"plant", "controller"}
    conditions = [need for service in services.values() for need in service.get("depends_on", {}).values()]
    assert conditions == [{"condition": "service_healthy"}] * 3


def test_the_image_runs_without_privileges_from_locked_dependencies() -> None:
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    assert "ARG BASE=python:3.11-slim-bookworm" in lines
    assert "USER longreach" in lines
    assert any("--require-hashes" in line for line in lines)
    assert all(service["cap_drop"] == ["ALL"] for service in document()["services"].values())


def test_the_image_has_a_folder_of_its_user_for_every_volume_of_secrets() -> None:
    """A volume that is filled from the image takes over the owner of its folder; else it is root's."""
    made = next(line for line in (ROOT / "Dockerfile").read_text().splitlines() if "-m 700" in line).split()
    mounts = {mount.split(":")[1] for mount in document()["services"]["tokens"]["volumes"]}
    assert mounts <= set(made)


def test_the_profile_of_figures_reads_the_faces_that_the_services_have() -> None:
    services = document()["services"]
    profile = {name for name, each in services.items() if each.get("profiles") == ["metrics"]}
    assert profile == {"prometheus", "grafana"}
    assert services["grafana"]["ports"] == ["127.0.0.1:${LONGREACH_GRAFANA_PORT:-3000}:3000"]
    (job,) = yaml.safe_load((ROOT / "grafana" / "prometheus.yml").read_text())["scrape_configs"]
    token = job["authorization"]["credentials_file"]
    assert token in services["tokens"]["command"]
    for target, stem in (("plant", "plant_service"), ("controller", "controller"), ("vision", "vision")):
        assert f"{target}:9100" in job["static_configs"][0]["targets"]
        command = services[target]["command"]
        assert f"{stem}.live.tokens.look.file={token}" in command
        assert f"{stem}.live.allowed_hosts=[{target}]" in command
        assert f"{stem}.live.port=${{LONGREACH_LIVE_PORT:-null}}" in command
        words = [word.replace("${LONGREACH_LIVE_PORT:-null}", "null") for word in command if ".live." in word]
        assert parse_overrides(words)[stem]["live"]["port"] is None, "off without the profile's variable"


def test_the_profile_of_campaigns_is_one_image_on_the_internal_network() -> None:
    services = document()["services"]
    profile = {name: each for name, each in services.items() if each.get("profiles") == ["campaign"]}
    assert set(profile) == {"scheduler", "worker", "campaign"}
    for each in profile.values():
        assert (each["image"], each["networks"]) == ("longreach:latest", ["machine"])
        assert "ports" not in each
    assert profile["worker"]["command"][2] == "tcp://scheduler:8786"
    assert profile["worker"]["command"][3:5] == ["--nthreads", "1"], "a run has a core of its own"
    (_, rows) = profile["campaign"]["volumes"][1].split(":")
    assert f" {rows} " in (ROOT / "Dockerfile").read_text().replace("\\\n", " "), "else root's"


@pytest.mark.docker
def test_compose_accepts_the_file() -> None:
    compose = compose_command()
    if compose is None:
        pytest.fail("no Docker engine with Compose answers here")
    checked = subprocess.run([*compose, "config", "-q"], cwd=ROOT, capture_output=True, text=True)
    assert checked.returncode == 0, checked.stderr


@pytest.fixture
def containers(tmp_path: Path) -> Iterator[tuple[str, bytes, Path]]:
    """The REST face's address, the token to operate, and the plant's record directory of three containers."""
    compose = compose_command()
    if compose is None:
        pytest.fail("no Docker engine with Compose answers here")
    records = tmp_path / "records"
    records.mkdir()
    records.chmod(0o777)  # the container's user is nobody here
    override = tmp_path / "record.yml"
    command = [*document()["services"]["plant"]["command"], "--record-dir", "/records/plant"]
    plant = {"command": command, "volumes": ["/var/lib/longreach", f"{records}:/records"]}
    override.write_text(yaml.safe_dump({"services": {"plant": plant}}))
    port = free_port()
    files = ["-f", str(ROOT / "docker-compose.yml"), "-f", str(override)]
    base = [*compose, "-p", PROJECT, "--project-directory", str(ROOT), *files]
    environment = {"LONGREACH_PORT": str(port), "PATH": "/usr/local/bin:/usr/bin:/bin"}

    def call(*arguments: str) -> str:
        done = subprocess.run([*base, *arguments], env=environment, capture_output=True, text=True, cwd=ROOT)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    try:
        call("up", "--build", "-d")
        token = bytes.fromhex(call("exec", "-T", "vision", "cat", f"{TOKENS}/operate"))
        yield f"http://127.0.0.1:{port}", token, records / "plant"
    finally:
        print(call("logs", "--tail", "5"))
        call("down", "-v")


@pytest.mark.docker
@pytest.mark.timeout(1800)
def test_three_containers_bring_the_tool_to_the_object(containers: tuple[str, bytes, Path]) -> None:
    url, token, records = containers
    rig = RestRig(url, token)
    rig.wait_healthy(180.0)
    for wrong in ({}, {"Authorization": f"Bearer {bytes(32).hex()}"}):
        assert httpx.post(f"{url}/enable", headers=wrong, timeout=20.0).status_code == 401
    for port in (1502, 47100):
        with (
            pytest.raises(OSError, match=r"refused|timed out"),
            socket.create_connection(("127.0.0.1", port), 1.0),
        ):
            pytest.fail(f"port {port} must not be published")
    rig.command("enable")
    with bars(quiet=True) as shown, shown.step("containers") as bar:
        rig.operate("orientation-adjustment", {}, bar)
        rig.operate("trajectory-matching", {}, bar)
        for _ in range(2):
            result = rig.operate("look-then-move", {"inputs": 1}, bar)
    print(json.dumps(result.final.error_m.tolist()), json.dumps(rig.state()["cycle"]))
    rig.close()
    assert result.final.inside
    time.sleep(1.0)
    truths = [record.truth for record in read_truth(records / "truth.mcap").truths[-20:]]
    error = np.mean([tool_error(truth, CLEARANCE_M) for truth in truths], axis=0)
    print(f"true error {1e3 * error} mm")
    assert np.all(np.abs(error[:2]) < LIMIT_M)
