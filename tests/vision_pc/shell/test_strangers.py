"""What strangers try at the vision PC's REST API, and what our own clients tell them."""

import re
import socket

import httpx
import pytest

from testbed.realtime.rest_rig import RestRig
from tests.vision_pc.shell.rest_server import rest_face

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
