"""Pages of other origins, too many followers: what strangers try at the vision PC's REST API."""

import contextlib
import http.client
import re
import socket
import time
from collections.abc import Callable

import httpx
import pytest

from testbed.realtime.rest_rig import RestRig
from tests.vision_pc.shell.rest_server import rest_face, served_bench
from vision_pc.shell.rest.operation_routes import MAX_FOLLOWERS

pytestmark = pytest.mark.realtime


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


def test_our_own_clients_ask_no_proxy_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """The token that operates would go to whoever is named there."""
    with socket.create_server(("127.0.0.1", 0)) as proxy, rest_face() as url:
        monkeypatch.setenv("http_proxy", f"http://127.0.0.1:{proxy.getsockname()[1]}")
        monkeypatch.setenv("ALL_PROXY", f"http://127.0.0.1:{proxy.getsockname()[1]}")
        rig = RestRig(url)
        assert rig.state()["group_state"] == "standby"
        rig.close()
        proxy.settimeout(0.1)
        with pytest.raises(TimeoutError):
            proxy.accept()
