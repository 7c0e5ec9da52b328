"""Pages of other origins, too many followers: what strangers try at the vision PC's REST API."""

import contextlib
import http.client
import http.server
import re
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from fastapi.responses import HTMLResponse

from tests.vision_pc.shell.rest_server import rest_face, served_bench
from tests.vision_pc.synthetic_station import Bench
from vision_pc.shell.rest.operation_routes import MAX_FOLLOWERS

pytestmark = pytest.mark.realtime

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
BROWSER_S = 90.0
ATTACK = """<!doctype html><title>kittens</title><script>
const say = what => fetch('/said/' + what);
const tried = async (name, address, options) => {{
  try {{
    const answer = await fetch(address, options);
    await say(name + '/' + answer.type + '/' + answer.status);
  }} catch (error) {{ await say(name + '/failed/0'); }}
}};
(async () => {{
  await tried('enable', '{api}/enable', {{method: 'POST', mode: 'no-cors'}});
  await tried('plain', '{api}/operations/local-track', {{method: 'POST', mode: 'no-cors', body: '{{}}'}});
  await tried('state', '{api}/state', {{mode: 'cors'}});
  await say('end/end/0');
}})();
</script>"""
OWN_PAGE = """<!doctype html><title>our own</title><script>
fetch('/enable', {method: 'POST'}).then(answer => { document.title = 'enabled ' + answer.status; });
</script>"""


class Attacker(http.server.ThreadingHTTPServer):
    """A web server of somebody else; ``said`` is what its page reported."""

    def __init__(self, api: str) -> None:
        super().__init__(("127.0.0.1", 0), _AttackersAnswer)
        self.page = ATTACK.format(api=api).encode()
        self.said: list[str] = []
        self.ended = threading.Event()


class _AttackersAnswer(http.server.BaseHTTPRequestHandler):
    server: Attacker

    def do_GET(self) -> None:
        if self.path.startswith("/said/"):
            self.server.said.append(self.path.removeprefix("/said/"))
        if self.path.startswith("/said/end"):
            self.server.ended.set()
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(self.server.page if self.path == "/" else b"")

    def log_message(self, format: str, *arguments: Any) -> None:
        """Say nothing."""


@contextlib.contextmanager
def attacker(api: str) -> Iterator[Attacker]:
    with Attacker(api) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join(10.0)


def browsed(url: str, profile: Path, until: threading.Event | None = None) -> str:
    """The page's DOM a moment after it was loaded, empty after ``until``; evil.example is this machine."""
    assert BROWSER is not None
    arguments = [
        BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
        f"--user-data-dir={profile}", "--host-resolver-rules=MAP evil.example 127.0.0.1",
    ]  # fmt: skip
    if until is None:
        arguments += ["--virtual-time-budget=5000", "--dump-dom"]
        shown = subprocess.run(
            [*arguments, url], capture_output=True, text=True, timeout=BROWSER_S, check=True
        )
        return shown.stdout
    with subprocess.Popen(
        [*arguments, "--remote-debugging-port=0", url], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as browser:
        try:
            assert until.wait(BROWSER_S), "the browser never ran the page to its end"
        finally:
            browser.terminate()
    return ""


def causes(bench: Bench) -> set[str]:
    return {line["cause"] for line in bench.events("request_refused")}


def add_own_page(app: FastAPI) -> None:
    @app.get("/own", include_in_schema=False)
    async def own() -> HTMLResponse:
        policy = {"Content-Security-Policy": "script-src 'unsafe-inline'; connect-src 'self'"}
        return HTMLResponse(OWN_PAGE, headers=policy)


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here: the attack was NOT tried with a real browser")
def test_a_page_of_another_origin_enables_nothing_and_reads_nothing_in_a_real_browser(tmp_path: Path) -> None:
    with served_bench(enabled=False, add=add_own_page) as (url, bench), attacker(url) as evil:
        for number, name in enumerate(
            ("evil.example", "127.0.0.1")
        ):  # cross-site, then another port of this host
            evil.ended.clear()
            evil.said.clear()
            profile = tmp_path / str(number)
            browsed(f"http://{name}:{evil.server_port}/", profile, evil.ended)
            assert evil.said[-1] == "end/end/0"
            assert "state/failed/0" in evil.said  # not readable
            assert {line.split("/")[0] for line in evil.said} == {"enable", "plain", "state", "end"}
            assert httpx.get(f"{url}/state").json()["group_state"] == "disabled"
        assert not bench.operations.list()
        assert causes(bench) == {"refused.foreign_origin"}
        rebound = browsed(url.replace("127.0.0.1", "evil.example") + "/state", tmp_path / "rebound")
        assert "refused.foreign_host" in rebound
        assert "group_state" not in rebound
        assert "enabled 200" in browsed(f"{url}/own", tmp_path / "own")  # our own page goes on working
        assert httpx.get(f"{url}/state").json()["group_state"] == "standby"


def test_a_page_of_another_origin_enables_nothing_by_the_browsers_headers() -> None:
    with served_bench(enabled=False) as (url, bench):
        foreign = {
            "Origin": "http://evil.example:18999",
            "Referer": "http://evil.example:18999/",
            "Sec-Fetch-Site": "cross-site",
            "Sec-Fetch-Mode": "no-cors",
            "Sec-Fetch-Dest": "empty",
        }
        every = (
            "enable",
            "emergency-release",
            "reset",
            "operations/local-track",
            "operations/look-then-move",
        )
        for path in every:
            answer = httpx.post(
                f"{url}/{path}", headers=foreign | {"Content-Type": "text/plain"}, content=b"{}"
            )
            assert (answer.status_code, answer.json()["cause"]) == (403, "refused.foreign_origin")
        for path in ("state", "operations", "camera/latest.png", "openapi.json", "docs"):
            assert httpx.get(f"{url}/{path}", headers={"Sec-Fetch-Site": "cross-site"}).status_code == 403
        assert httpx.get(f"{url}/state", headers={"Host": "evil.example"}).status_code == 421
        assert httpx.get(f"{url}/state").json()["group_state"] == "disabled"
        assert not bench.operations.list()
        assert httpx.post(f"{url}/enable").status_code == 200  # curl and our own clients


def test_the_interactive_page_loads_nothing_from_elsewhere() -> None:
    with rest_face() as url:
        answer = httpx.get(f"{url}/docs", headers={"Sec-Fetch-Site": "none"})
        policy = dict(
            part.strip().split(" ", 1) for part in answer.headers["content-security-policy"].split(";")
        )
        assert answer.status_code == 200
        assert "://" not in answer.text
        assert {policy[part] for part in ("default-src", "script-src", "style-src", "connect-src")} == {
            "'none'",
            "'self'",
        }
        loaded = re.findall(r'(?:src|href)="(/[^"]+)"', answer.text)
        assert len(loaded) == 3
        for path in loaded:
            assert httpx.get(f"{url}{path}").headers["content-type"].startswith("text/"), path
        assert httpx.get(f"{url}/redoc").status_code == 404


def follow(port: int, operation: str) -> socket.socket:
    sock = socket.create_connection(("127.0.0.1", port), timeout=20.0)
    sock.sendall(f"GET /operations/{operation}/events HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
    return sock


@pytest.mark.slow("a thousand connections")
def test_a_thousand_followers_are_refused_and_a_stop_is_answered() -> None:
    with served_bench() as (url, bench), contextlib.ExitStack() as stack:
        port = int(url.rpartition(":")[2])
        bench.controller.speed = 0.0001  # it is under way for as long as this takes
        moving = httpx.post(f"{url}/operations/move", json={"offset_base_m": [0.05, 0.0, 0.0]})
        operation = moving.json()["id"]
        followers = [stack.enter_context(follow(port, operation)) for _ in range(1000)]
        statuses = [sock.recv(12) for sock in followers]
        assert statuses.count(b"HTTP/1.1 200") == MAX_FOLLOWERS
        assert statuses.count(b"HTTP/1.1 503") == 1000 - MAX_FOLLOWERS
        assert refused_cause(url, operation) == "refused.too_many_connections"
        for sock, status in zip(followers, statuses, strict=True):
            if status == b"HTTP/1.1 503":
                sock.close()
        eventually(lambda: refused_cause(url, operation) == "refused.too_many_followers")
        for sock in followers[:10]:  # those who leave make room
            sock.close()
        eventually(lambda: bench_status(port, operation) == 200)
        assert httpx.get(f"{url}/operations/{operation}").json()["state"] == "running"
        for _ in range(1000):
            stack.enter_context(follow(port, operation))
        assert httpx.post(f"{url}/reset").json()["cause"] == "refused.too_many_connections"
        assert httpx.post(f"{url}/stop", timeout=20.0).status_code == 200
        assert bench.operations.get(operation).state in ("cancelled", "failed")


def eventually(happened: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60.0
    while not happened():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def refused_cause(url: str, operation: str) -> str:
    """Why one more follower is refused."""
    answer = httpx.get(f"{url}/operations/{operation}/events")
    assert answer.status_code == 503
    return str(answer.json()["cause"])


def bench_status(port: int, operation: str) -> int:
    """The status of one more follower, who leaves at once."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20.0)
    try:
        connection.request("GET", f"/operations/{operation}/events")
        return connection.getresponse().status
    finally:
        connection.close()
