"""What services are started with: the emulator's face and the console know each other, or neither does."""

from pathlib import Path

import pytest

from foundation.configuration import merged
from protocol.errors import ConfigurationError
from testbed.realtime import launch as launching
from testbed.realtime.launch import Launch, prepare
from testbed.scenarios.scenario import load_settings, with_face
from tests.support.paths import CONFIGS


@pytest.fixture(autouse=True)
def nobody_listens(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is started here: whether others of this machine have a port does not matter."""
    monkeypatch.setattr(launching, "check_ports", lambda uses: None)


def launch(tmp_path: Path, allow_faults: bool, show_truth: bool) -> Launch:
    """Prepared as `longreach up` does."""
    return prepare(CONFIGS, with_face({}, allow_faults, show_truth), tmp_path, any_ports=True)


def test_as_shipped_the_console_knows_of_no_emulator(tmp_path: Path) -> None:
    settings = launch(tmp_path, False, False).settings
    assert settings.vision.api.emulator_face == ""
    assert not settings.plant_service.fault_face.allowed_origins
    assert not settings.plant_service.fault_face.shows_truth


@pytest.mark.parametrize(("allow_faults", "show_truth"), [(True, False), (False, True), (True, True)])
def test_a_face_that_offers_something_is_introduced(
    tmp_path: Path, allow_faults: bool, show_truth: bool
) -> None:
    prepared = launch(tmp_path, allow_faults, show_truth)
    face, api = prepared.settings.plant_service.fault_face, prepared.settings.vision.api
    assert (face.allowed, face.shows_truth) == (allow_faults, show_truth)
    assert api.emulator_face == f"http://127.0.0.1:{face.port}"
    assert set(face.allowed_origins) == {prepared.rest_url, f"http://localhost:{api.port}"}
    plant, _, vision = (service.arguments for service in prepared.services)
    assert f"vision.api.emulator_face={api.emulator_face}" in vision
    assert any("allowed_origins" in argument for argument in plant)


@pytest.mark.parametrize("address", ["javascript:alert(1)", "http://a b", "http://a; script-src *"])
def test_an_address_that_is_none_is_refused(address: str) -> None:
    with pytest.raises(ConfigurationError, match="emulator_face"):
        load_settings(CONFIGS, merged({}, {"vision": {"api": {"emulator_face": address}}}))


def test_the_live_view_gets_its_keys_and_the_services_its_socket(tmp_path: Path) -> None:
    hosts = {"live": {"allowed_hosts": ["bench"]}}
    *services, live = prepare(CONFIGS, hosts, tmp_path, any_ports=True, foxglove=8765).services
    ((_, feeds),) = live.environment
    assert (live.module, set(live.arguments)) == (
        "foundation.live",
        {"live.allowed_hosts=[bench]", "live.port=8765"},
    )
    assert all(dict(service.environment)["LONGREACH_LIVE"] == feeds for service in services)
    assert not any("live." in argument for service in services for argument in service.arguments)


@pytest.mark.parametrize(("keys", "foxglove"), [({"prt": 1}, 8765), ({"allowed_hosts": ["bench"]}, None)])
def test_keys_of_the_live_view_that_nobody_reads_are_refused(
    tmp_path: Path, keys: dict[str, object], foxglove: int | None
) -> None:
    with pytest.raises(ConfigurationError, match="live"):
        prepare(CONFIGS, {"live": keys}, tmp_path, any_ports=True, foxglove=foxglove)
