"""The reference link in numbers, and with a key: real sockets, and the protocol's own server session."""

from pathlib import Path

import numpy as np
import pytest

from foundation.secret_source import SecretSource, key_from_file
from protocol.errors import LinkLost
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import ANY_ARM
from tests.support.log_lines import HeardLog
from tests.vision_pc.shell.loopback_controller import LoopbackController, until
from tests.vision_pc.synthetic import SyntheticRig, draw
from tests.vision_pc.synthetic_station import bench
from vision_pc.config.vision import LinkSettings
from vision_pc.shell.camera_eyes import ProcessClock
from vision_pc.shell.link.udp_endpoint import UdpEndpoint
from vision_pc.shell.rest.state_view import link_view

pytestmark = pytest.mark.realtime


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    path = tmp_path / "link.key"
    path.write_text("5a" * 32)
    path.chmod(0o600)
    return path


def a_controller(key_file: Path | None = None) -> LoopbackController:
    rig = SyntheticRig(draw(np.random.default_rng(0)), 0, rate_hz=100.0)
    return LoopbackController(rig, key=key_from_file(key_file) if key_file else None)


def a_link(port: int, log: HeardLog, key_file: Path | None = None) -> UdpEndpoint:
    settings = LinkSettings(port=port, state_period_ms=10, link_key=SecretSource(file=key_file))
    return UdpEndpoint(settings, ANY_ARM, log, ProcessClock())


async def test_a_controller_that_enable_alone_sets_going_is_told_while_it_is_there() -> None:
    async with bench(tries_valves=True) as made:
        assert (await made.client.get("/link")).json()["tries_valves"] is True
        await made.controller.stop()
        await until(lambda: not made.station.controller.connected)
        assert (await made.client.get("/link")).json()["tries_valves"] is False


async def test_the_rest_face_shows_the_link() -> None:
    async with bench() as made:
        seen = (await made.client.get("/link")).json()
        assert seen["connected"] is True
        assert seen["authenticated"] is False
        assert seen["tries_valves"] is False
        assert seen["datagrams"]["received"] >= 1
        assert seen["dropped"] == 0
        assert seen["clock"]["uncertainty_ns"] > 0
        assert seen["controller"] == {"references_lost": 0, "references_dropped": 0}
        made.station.controller.receive(b"nonsense")  # type: ignore[attr-defined]
        later = (await made.client.get("/link")).json()
        assert later["datagrams"]["refused"] == later["dropped"] == 1
        assert later["datagrams"]["received"] >= seen["datagrams"]["received"]
        document = (await made.client.get("/openapi.json")).json()
        assert (
            document["components"]["schemas"]["LinkStatistics"]["properties"].keys()
            == seen["datagrams"].keys()
        )
        await made.controller.stop()
        await until(lambda: not made.station.controller.connected)
        gone = (await made.client.get("/link")).json()
        assert gone["connected"] is False
        assert gone["controller"] is None


async def test_with_the_same_key_the_link_is_authenticated(key_file: Path) -> None:
    controller, log = a_controller(key_file), HeardLog("vision_pc")
    await controller.start()
    endpoint = a_link(controller.port, log, key_file)
    link = endpoint.link
    await endpoint.start()
    await until(lambda: link.connected)
    assert (await link.command(CommandCode.ENABLE)).reason is Reason.ACCEPTED
    view = link_view(link)
    assert view.authenticated
    assert view.dropped == 0
    await endpoint.close()
    await controller.stop()
    assert log.lines("link_connected")
    assert "5a5a" not in log.text()


@pytest.mark.parametrize(
    ("ours", "theirs", "why"), [(False, True, "not authenticated"), (True, False, "key not configured")]
)
async def test_a_key_that_one_side_does_not_have_is_told_and_nothing_moves(
    key_file: Path, ours: bool, theirs: bool, why: str
) -> None:
    controller = a_controller(key_file if theirs else None)
    await controller.start()
    endpoint = a_link(controller.port, HeardLog("vision_pc"), key_file if ours else None)
    link = endpoint.link
    await endpoint.start()
    await until(lambda: why in str(link.not_connected()))
    with pytest.raises(LinkLost) as refused:
        await link.command(CommandCode.ENABLE)
    assert refused.value.cause == f"link.{why.replace(' ', '_')}"
    assert controller.requests == []
    assert controller.session.session is None
    await endpoint.close()
    await controller.stop()
