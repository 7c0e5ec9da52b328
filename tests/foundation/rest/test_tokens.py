"""Tokens of a REST API over real sockets: none, a wrong one, the other role's; compulsory beyond loopback."""

import base64
import http.client
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from fastapi import FastAPI
from pydantic import Field

from foundation.configuration import HostName, StrictModel
from foundation.rest.guard import Access, Role
from foundation.rest.server import install_problems
from foundation.rest.tokens import TokenSources, configured_access, is_loopback
from foundation.secret_source import SecretSource, write_new_secret
from protocol.errors import ConfigurationError
from tests.foundation.rest.serving import serving
from tests.support.log_lines import HeardLog

pytestmark = pytest.mark.slow("services start with and without tokens")

LOOK, OPERATE, NOBODY = bytes(range(32)), bytes(range(100, 132)), bytes(32)
ACCESS = Access((), {Role.LOOK: LOOK, Role.OPERATE: OPERATE}, frozenset({"/stop"}))


class Answer(NamedTuple):
    """What came back."""

    status: int
    headers: http.client.HTTPMessage
    document: Any

    @property
    def said(self) -> tuple[int, str]:
        return self.status, self.document.get("cause", "")


class GroupRequest:
    """A small API with tokens: ``done`` are the POSTs that got through."""

    def __init__(self, port: int, done: list[str], log: HeardLog, refused: dict[str, int]) -> None:
        self.port, self.done, self.log, self.refused = port, done, log, refused

    def ask(self, method: str, path: str, authorization: str | None) -> Answer:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20.0)
        try:
            connection.request(
                method, path, headers={} if authorization is None else {"Authorization": authorization}
            )
            response = connection.getresponse()
            return Answer(response.status, response.headers, json.loads(response.read() or b"{}"))
        finally:
            connection.close()


@pytest.fixture(scope="module")
def api() -> Iterator[GroupRequest]:
    done: list[str] = []
    app = FastAPI()
    install_problems(app, {})

    @app.post("/{what}")
    async def act(what: str) -> dict[str, str]:
        done.append(what)
        return {"did": what}

    @app.get("/state")
    async def state() -> dict[str, str]:
        return {"group_state": "disabled"}

    log = HeardLog()
    with serving(app, ACCESS, log) as served:
        yield GroupRequest(served.port, done, log, served.refused)
    log.close()


def bearer(token: bytes) -> str:
    return f"Bearer {token.hex()}"


def basic(token: bytes) -> str:
    return "Basic " + base64.b64encode(b"anybody:" + token.hex().encode()).decode()


@pytest.mark.parametrize("present", [bearer, basic])
def test_each_role_does_what_it_may(api: GroupRequest, present: Any) -> None:
    before = len(api.done)
    assert api.ask("GET", "/state", present(LOOK)).status == 200
    assert api.ask("GET", "/state", present(OPERATE)).status == 200
    assert api.ask("POST", "/enable", present(OPERATE)).status == 200
    assert api.ask("POST", "/stop", present(LOOK)).status == 200  # whoever may watch may stop
    assert api.ask("POST", "/enable", present(LOOK)).said == (403, "refused.role")
    for method in ("DELETE", "PUT", "PATCH", "OPTIONS"):
        assert api.ask(method, "/state", present(LOOK)).said == (403, "refused.role")
    assert api.done[before:] == ["enable", "stop"]


@pytest.mark.parametrize(
    "authorization",
    [
        bearer(NOBODY), basic(NOBODY), "Bearer", "Bearer ", "Bearer zz", bearer(OPERATE)[:-2],
        bearer(OPERATE) + "00", f"Token {OPERATE.hex()}", OPERATE.hex(), "Basic ", "Basic !!!",
        "Basic " + base64.b64encode(OPERATE).decode(), "Bearer \xff\xfe",
        "Basic " + base64.b64encode(b"\xff:\xff").decode(), "",
    ],
)  # fmt: skip
def test_another_token_is_refused(api: GroupRequest, authorization: str) -> None:
    before = len(api.done)
    for method, path in (("GET", "/state"), ("POST", "/enable"), ("POST", "/stop")):
        answer = api.ask(method, path, authorization)
        assert answer.said == (401, "refused.wrong_token")
        assert answer.headers.get_all("WWW-Authenticate")
    assert len(api.done) == before


def test_without_a_token_it_says_what_is_wanted(api: GroupRequest) -> None:
    before = len(api.done)
    answer = api.ask("POST", "/stop", None)
    assert answer.said == (401, "refused.no_token")
    schemes = [value.split()[0] for value in answer.headers.get_all("WWW-Authenticate") or ()]
    assert schemes == ["Bearer", "Basic"]  # programs; browsers
    assert len(api.done) == before


def test_two_authorizations_are_refused(api: GroupRequest) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", api.port, timeout=20.0)
    connection.putrequest("POST", "/enable")
    for token in (OPERATE, OPERATE):
        connection.putheader("Authorization", bearer(token))
    connection.endheaders()
    assert connection.getresponse().status == 401
    connection.close()


def test_refusals_are_counted_and_told_without_the_token(api: GroupRequest) -> None:
    before = dict(api.refused)
    for _ in range(64):
        api.ask("GET", "/state", bearer(NOBODY))
    assert api.refused["refused.wrong_token"] == before.get("refused.wrong_token", 0) + 64
    told = api.log.text()
    wrong = [line for line in api.log.lines() if line["cause"] == "refused.wrong_token"]
    assert 1 <= len(wrong) <= 8
    assert {line["source"] for line in wrong} == {"127.0.0.1"}
    for token in (LOOK, OPERATE, NOBODY):
        assert token.hex() not in told


class Settings(StrictModel):
    """Of an API."""

    host: str = "127.0.0.1"
    allowed_hosts: tuple[HostName, ...] = ()
    tokens: TokenSources = Field(default_factory=TokenSources)


@pytest.mark.parametrize(
    ("host", "here"),
    [
        ("127.0.0.1", True), ("127.8.9.1", True), ("localhost", True), ("::1", True), ("0.0.0.0", False),
        ("", False), ("10.0.0.7", False), ("localhost.evil.example", False), ("vision-pc", False),
        ("::", False),
    ],
)  # fmt: skip
def test_beyond_loopback_a_token_is_compulsory(tmp_path: Path, host: str, here: bool) -> None:
    assert is_loopback(host) is here
    token = tmp_path / "operate.token"
    write_new_secret(token)
    named = Settings(host=host, tokens=TokenSources(operate=SecretSource(file=token)))
    assert set(configured_access(named, "x.api").tokens) == {Role.OPERATE}
    if here:
        assert not configured_access(Settings(host=host), "x.api").tokens
        return
    with pytest.raises(ConfigurationError, match="longreach token new FILE") as caught:
        configured_access(Settings(host=host), "x.api")
    assert caught.value.cause == "configuration.token_wanted"
    assert "x.api.tokens.operate.file" in str(caught.value)


def test_tokens_are_two_and_kept_to_oneself(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("look", "operate")]
    made = [sys.executable, "-m", "longreach", "token", "new", *map(str, files)]
    said = subprocess.run(made, capture_output=True, text=True, check=True).stdout
    texts = [path.read_text() for path in files]
    assert len({*texts}) == 2
    assert all(len(bytes.fromhex(text)) == 32 and text.strip() not in said for text in texts)
    assert {path.stat().st_mode & 0o777 for path in files} == {0o600}
    again = subprocess.run(made, capture_output=True, text=True, check=False)
    assert (again.returncode, [path.read_text() for path in files]) == (2, texts)
    assert "configuration.secret_exists" in again.stderr
    subprocess.run([*made, "--keep"], check=True)
    assert [path.read_text() for path in files] == texts
    sources = TokenSources(look=SecretSource(file=files[0]), operate=SecretSource(file=files[0]))
    with pytest.raises(ConfigurationError) as caught:
        configured_access(Settings(tokens=sources), "x.api")
    assert caught.value.cause == "configuration.tokens_equal"
    files[0].chmod(0o644)
    with pytest.raises(ConfigurationError) as caught:
        configured_access(Settings(tokens=sources), "x.api")
    assert caught.value.cause == "configuration.token_exposed"
    assert texts[0].strip() not in str(caught.value)


@pytest.mark.parametrize(
    ("module", "setting"), [("vision_pc", "vision.api"), ("plant_emulator", "plant_service.fault_face")]
)
def test_a_service_does_not_start_beyond_loopback_without_a_token(module: str, setting: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", module, "--set", f"{setting}.host=0.0.0.0"],
        capture_output=True, text=True, timeout=300.0, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "configuration.token_wanted" in done.stderr
    assert f"--set {setting}.tokens.operate.file=FILE" in done.stderr
    assert not done.stdout
