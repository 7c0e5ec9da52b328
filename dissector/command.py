"""``longreach sniff``: the reference link's traffic, decoded."""

import itertools
import json
from pathlib import Path
from typing import Annotated

import typer

from dissector.capture import from_file, from_interface
from dissector.spoken import TagReader, as_fields, as_line, is_ours
from foundation.secret_source import key_from_file


def sniff(
    pcap: Annotated[Path | None, typer.Option(help="Read this capture instead of an interface.")] = None,
    interface: Annotated[str, typer.Option(help="Listen here; needs CAP_NET_RAW.")] = "lo",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="The controller's port, unsound datagrams too; 0: by magic.")
    ] = 0,
    count: Annotated[int, typer.Option(min=0, help="End after so many datagrams; 0: never.")] = 0,
    key: Annotated[
        Path | None, typer.Option(help="File with the shared key: judge the tags of sessions seen to open.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json-lines", help="One JSON object a datagram.")] = False,
) -> None:
    """Print every datagram of the reference link, with the cause where a receiver would drop it."""
    packets = from_file(pcap) if pcap is not None else from_interface(interface)
    ours = (packet for packet in packets if is_ours(packet, port))
    tags = TagReader(None if key is None else key_from_file(key))
    began_s: float | None = None
    try:
        for packet in itertools.islice(ours, count or None):
            began_s = packet.time_s if began_s is None else began_s
            typer.echo(json.dumps(as_fields(packet, tags)) if as_json else as_line(packet, began_s, tags))
    except KeyboardInterrupt:
        return
