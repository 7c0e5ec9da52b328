"""``unshare -Urnm``: a controller that comes back at another address, while its old one is somebody else's.

Prints ``found at ADDRESS`` for each place at which the link found it. The name stands for two addresses in
/etc/hosts of this namespace alone, an IPv6 one first, at which nobody is.
"""

import asyncio
import io
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import uvloop

from foundation.event_log import EventLog
from protocol.reference_messages import ANY_ARM
from tests.vision_pc.shell.loopback_controller import LoopbackController, until
from tests.vision_pc.synthetic import SyntheticRig, draw
from vision_pc.config.vision import LinkSettings
from vision_pc.shell.camera_eyes import ProcessClock
from vision_pc.shell.link.udp_endpoint import UdpEndpoint

NAME = "controller.cell"
PLACES = ("127.0.0.2", "127.0.0.3", "127.0.0.2", "::1")


def names(hosts: Path, address: str) -> None:
    """Have the name stand for it, written where /etc/hosts is."""
    others = [] if ":" in address else ["::1"]
    hosts.write_text("".join(f"{each} {NAME}\n" for each in (*others, address)))


async def found_at_each() -> None:
    """Raises AssertionError when the link does not find a controller again."""
    with tempfile.TemporaryDirectory() as folder:
        hosts = Path(folder) / "hosts"
        names(hosts, PLACES[0])
        subprocess.run(["mount", "--bind", hosts, "/etc/hosts"], check=True)  # noqa: ASYNC221
        log, port = EventLog("vision_pc", io.StringIO()), 47011
        endpoint = UdpEndpoint(LinkSettings(host=NAME, port=port), ANY_ARM, log, ProcessClock())
        for number, address in enumerate(PLACES):
            names(hosts, address)
            rig = SyntheticRig(draw(np.random.default_rng(0)), 0, rate_hz=100.0)
            controller = LoopbackController(rig)
            strangers = [other for other in PLACES[:2] if other != address]
            plants = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in strangers]
            for plant, other in zip(plants, strangers, strict=True):
                plant.bind((other, port))
            await controller.start(port, address)
            if number == 0:
                await endpoint.start()
            await until(lambda: endpoint.link.connected, 20.0)
            print("found at", address, flush=True)
            await controller.stop(say_goodbye=False)
            for plant in plants:
                plant.close()
            await until(lambda: not endpoint.link.connected, 20.0)
        await endpoint.close()


if __name__ == "__main__":
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:  # as the service does
        sys.exit(runner.run(found_at_each()))
