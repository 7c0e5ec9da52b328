"""``longreach proxy``: stands between two peers at the terminal and spoils what passes."""

import asyncio
import json
import signal
from pathlib import Path
from typing import Annotated

import typer

from foundation.command_options import unfolded
from foundation.ports import known_host
from protocol.errors import ConfigurationError
from testbed.fault_proxy.faults import Faults
from testbed.fault_proxy.proxy import FaultProxy, Route, TcpProxy, UdpProxy


@unfolded
def proxy(
    route: Route,
    faults: Faults,
    tcp: Annotated[bool, typer.Option("--tcp", help="Streams instead of datagrams.")] = False,
    only: Annotated[str, typer.Option(help="both, to-server or to-client.")] = "both",
    seed: Annotated[int, typer.Option(min=0, help="The same seed is the same fate.")] = 1,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the counts to this file.")] = None,
) -> None:
    """Stand between two peers and lose, delay, reorder, cut or bend what passes, until Ctrl-C."""
    if only not in ("both", "to-server", "to-client"):
        raise ConfigurationError("proxy.direction", f"--only {only}: wanted both, to-server or to-client")
    known_host(route.host)
    up, down = (faults if only in ("both", way) else Faults() for way in ("to-server", "to-client"))
    kind = TcpProxy if tcp else UdpProxy
    counts = asyncio.run(_serve(kind(route, up, down, seed)))
    text = json.dumps(counts)
    typer.echo(text)
    if json_file is not None:
        json_file.write_text(text + "\n")


async def _serve(chosen: FaultProxy) -> dict[str, dict[str, int]]:
    stop = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    where = f"{chosen.route.listen_host}:{chosen.route.listen_port}"
    try:
        async with chosen:
            typer.echo(json.dumps({"event": "ready", "service": "fault_proxy", "port": chosen.port}))
            await stop.wait()
    except OSError as error:
        raise ConfigurationError("configuration.port_busy", f"{where}: {error.strerror}") from error
    return chosen.statistics()
