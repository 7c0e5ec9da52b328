"""One variable does without tokens: for this machine alone, and only if it says 1."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from foundation.rest import tokens as no_token
from foundation.rest.guard import Access
from foundation.rest.server import install_problems
from foundation.rest.tokens import NO_TOKEN, TokenSources, access_without_token, gateways
from foundation.secret_source import SecretSource, write_new_secret
from protocol.errors import ConfigurationError
from tests.foundation.rest.serving import serving

ROUTES = """Iface\tDestination\tGateway \tFlags\tRefCnt\tUse\tMetric\tMask\t\tMTU\tWindow\tIRTT
eth1\t00000000\t010012AC\t0003\t0\t0\t0\t00000000\t0\t0\t0
eth0\t000011AC\t00000000\t0001\t0\t0\t0\t0000FFFF\t0\t0\t0
"""


def settings(host: str, **sources: SecretSource) -> Any:
    return SimpleNamespace(host=host, allowed_hosts=(), tokens=TokenSources(**sources))


@pytest.fixture
def in_container(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mark").touch()
    (tmp_path / "route").write_text(ROUTES)
    monkeypatch.setattr(no_token, "_MARKS", (tmp_path / "mark",))
    monkeypatch.setattr(no_token, "_ROUTES", tmp_path / "route")


@pytest.fixture
def on_a_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(no_token, "_MARKS", (tmp_path / "none",))


@pytest.mark.parametrize("said", ["0", "true", "yes", " 1", "11"])
def test_anything_but_1_is_refused_by_name(said: str) -> None:
    with pytest.raises(ConfigurationError, match=f"LONGREACH_NO_TOKEN = {said!r}; wanted 1") as caught:
        access_without_token(settings("127.0.0.1"), "vision.api", {NO_TOKEN: said})
    assert caught.value.cause == "configuration.no_token"


def test_tokens_that_are_named_hold_unless_the_variable_is_set(tmp_path: Path) -> None:
    write_new_secret(tmp_path / "operate")
    named = settings("127.0.0.1", operate=SecretSource(file=tmp_path / "operate"))
    assert access_without_token(named, "vision.api", {}).tokens
    assert access_without_token(named, "vision.api", {NO_TOKEN: ""}).tokens
    access = access_without_token(named, "vision.api", {NO_TOKEN: "1"})
    assert (dict(access.tokens), access.senders) == ({}, None)


@pytest.mark.usefixtures("on_a_machine")
def test_beyond_loopback_a_machine_needs_tokens_all_the_same() -> None:
    for host in ("0.0.0.0", "192.168.1.5", "vision-pc"):
        with pytest.raises(ConfigurationError, match=f"loopback alone; vision.api.host is {host}"):
            access_without_token(settings(host), "vision.api", {NO_TOKEN: "1"})


@pytest.mark.usefixtures("in_container")
def test_a_container_serves_itself_and_its_gateway() -> None:
    access = access_without_token(settings("0.0.0.0"), "vision.api", {NO_TOKEN: "1"})
    assert access.senders == {"127.0.0.1", "::1", "172.18.0.1"}
    with pytest.raises(ConfigurationError, match="no token is named"):
        access_without_token(settings("0.0.0.0"), "vision.api", {})


def test_only_default_routes_have_the_gateway() -> None:
    assert gateways(ROUTES) == ["172.18.0.1"]
    assert gateways(ROUTES.splitlines()[0]) == []


@pytest.mark.parametrize(
    ("senders", "said"),
    [(frozenset({"127.0.0.1"}), (200, None)), (frozenset({"172.18.0.1"}), (403, "refused.other_machine"))],
)
def test_other_senders_are_refused(senders: frozenset[str], said: tuple[int, str | None]) -> None:
    app = FastAPI()
    install_problems(app, {})

    @app.get("/state")
    async def state() -> dict[str, str]:
        return {"group_state": "disabled"}

    with serving(app, Access(senders=senders)) as where:
        answer = httpx.get(f"http://127.0.0.1:{where.port}/state", timeout=20.0)
        assert (answer.status_code, answer.json().get("cause")) == said
