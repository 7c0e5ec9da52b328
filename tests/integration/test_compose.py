"""The containers: what the compose files and the image promise, without an engine."""

import re
import subprocess
import sys
from typing import Any

import yaml

from foundation.configuration import parse_overrides, validated
from foundation.incidents import INCIDENTS
from foundation.live import LiveSettings
from tests.support.paths import ROOT

TOKENS = "/var/lib/longreach-tokens"


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
    text = (ROOT / "Dockerfile").read_text().replace("\\\n", " ")
    assert "\nARG BASE=python:3.11-slim-bookworm\n" in text
    for stage in text.split("\nFROM ")[2:]:
        assert re.findall(r"^USER (\w+)$", stage, re.MULTILINE)[-1] == "longreach"
    installs = [line for line in text.splitlines() if re.search(r"pip.* \S*INSTALL|pip .*install", line)]
    assert len(installs) >= 3
    assert all("--require-hashes" in line or "wheel" in line or ".whl" in line for line in installs)
    assert all(service["cap_drop"] == ["ALL"] for service in document()["services"].values())


def test_the_image_has_a_folder_of_its_user_for_every_volume_of_secrets() -> None:
    """A volume that is filled from the image takes over the owner of its folder; else it is root's."""
    made = next(line for line in (ROOT / "Dockerfile").read_text().splitlines() if "-m 700" in line).split()
    mounts = {mount.split(":")[1] for mount in document()["services"]["tokens"]["volumes"]}
    assert mounts <= set(made)


def test_the_profile_of_figures_reads_the_live_view_that_the_services_feed() -> None:
    services = document()["services"]
    profile = {name for name, each in services.items() if each.get("profiles") == ["metrics"]}
    assert profile == {"live", "prometheus", "grafana"}
    assert services["grafana"]["ports"] == ["127.0.0.1:${LONGREACH_GRAFANA_PORT:-3000}:3000"]
    (job,) = yaml.safe_load((ROOT / "grafana" / "prometheus.yml").read_text())["scrape_configs"]
    token = job["authorization"]["credentials_file"]
    assert token in services["tokens"]["command"]
    settings = validated(LiveSettings, parse_overrides(services["live"]["command"][3:])["live"], "live")
    assert job["static_configs"][0]["targets"] == [f"{settings.allowed_hosts[0]}:{settings.port}"]
    assert str(settings.tokens.look.file) == token
    shared = "incidents:/var/lib/longreach-incidents"
    for name in ("plant", "controller", "vision", "live"):
        assert shared in services[name]["volumes"]
        assert services[name]["environment"]["LONGREACH_LIVE"] == "${LONGREACH_LIVE:-}", "off without it"


def test_the_profile_of_campaigns_is_one_image_on_the_internal_network() -> None:
    services = document()["services"]
    profile = {name: each for name, each in services.items() if each.get("profiles") == ["campaign"]}
    assert set(profile) == {"scheduler", "worker", "campaign"}
    for each in profile.values():
        assert (each["image"], each["build"]["target"]) == ("longreach-campaign:latest", "campaign")
        assert each["networks"] == ["machine"]
        assert "ports" not in each
    assert profile["worker"]["command"][2] == "tcp://scheduler:8786"
    assert profile["worker"]["command"][3:5] == ["--nthreads", "1"], "a run has a core of its own"
    (_, rows) = profile["campaign"]["volumes"][1].split(":")
    assert f" {rows} " in (ROOT / "Dockerfile").read_text().replace("\\\n", " "), "else root's"


def left_out(argument: str) -> list[str]:
    """The packages that an argument of the Dockerfile keeps out of the image of the services."""
    text = (ROOT / "Dockerfile").read_text().replace("\\\n", " ")
    return re.findall(rf'^ARG {argument}="(.*)"$', text, re.MULTILINE)[0].split()


def test_what_the_image_leaves_out_is_locked_and_no_service_imports_it() -> None:
    names = left_out("FOR_CAMPAIGNS") + left_out("FOR_BUILDS")
    locked = re.findall(r"^([a-z0-9-]+)==", (ROOT / "requirements.lock").read_text(), re.MULTILINE)
    assert len(names) > 25
    assert set(names) <= set(locked)
    program = (
        "import importlib.metadata as m, sys\n"
        "import controller.__main__, plant_emulator.__main__, vision_pc.__main__\n"
        "import conformance.command, testbed.cli.main, testbed.cli.token, testbed.realtime.contained\n"
        "import testbed.realtime.probe, testbed.lockstep.warm_up, plant_emulator.shell.camera_sender\n"
        "names = {each.lower().replace('_', '-') for top in m.packages_distributions().items()\n"
        "         if top[0] in sys.modules for each in top[1]}\n"
        "print(*sorted(names))"
    )
    used = subprocess.check_output([sys.executable, "-c", program], text=True, cwd=ROOT).split()
    assert "numba" in used
    assert set(used) & set(names) == set()


def test_the_three_services_are_started_anew_and_note_their_crashes() -> None:
    services = own_document()["services"]
    anew = {name: each.get("restart") for name, each in services.items()}
    assert anew == {"tokens": None, "plant": "on-failure", "controller": "on-failure", "vision": "on-failure"}
    for name in ("plant", "controller", "vision"):
        each = services[name]
        assert each["command"][:3] == ["python", "-m", "testbed.realtime.contained"]
        folder = each["environment"][INCIDENTS].rpartition("/")[0]
        assert f"incidents:{folder}" in each["volumes"]
