"""A PLC's variables over ADS: of our controller in structured text, and of TwinCAT."""

from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.options import JsonFile
from testbed.cli.root import CommandApp
from testbed.reporting.console import writable, write_json

_TOLD = "A PLC's variables over ADS: our controller in structured text, TwinCAT."
app = CommandApp(no_args_is_help=True, help=_TOLD)


@app.callback()
def plc() -> None:
    """A PLC's variables over ADS: our controller in structured text, TwinCAT."""


@app.command(
    epilog="Example: longreach plc watch PRG_LR_Controller.stArm.nCycle --seconds 10 --out watch.csv"
)
def watch(
    names: Annotated[
        list[str] | None, typer.Argument(help="Variables; without any: what there is to watch.")
    ] = None,
    at: Annotated[
        str,
        typer.Option(
            "--host",
            metavar="HOST[/NETID][:PORT]",
            help="Of the PLC: address, AMS net id (HOST.1.1), AMS port (851).",
        ),
    ] = "127.0.0.1",
    every_ms: Annotated[float, typer.Option(min=1.0, help="Between two rows.")] = 50.0,
    seconds: Annotated[float | None, typer.Option(min=0.0, help="Until Ctrl-C where not given.")] = None,
    find: Annotated[str, typer.Option(help="Of the list: names that hold this, in any letters.")] = "",
    to: Annotated[Path | None, typer.Option("--out", help="A CSV: time_s, then a column a variable.")] = None,
    json_file: JsonFile = None,
) -> None:
    """Show a PLC's variables as they change, and record them; all of a row are of one moment.

    Exit status 1 where the PLC goes silent. It reads and never writes. A TwinCAT of another machine needs a
    route to this one's AMS net id.
    """
    from testbed.plc_watch import WatchedPlc, list_symbols, plc_address, watch_values

    with WatchedPlc(*plc_address(at)) as watched:
        if not names:
            list_symbols(watched, find)
        else:
            seen = watch_values(watched, names, every_ms * 1e-3, seconds, writable(to))
            write_json(json_file, seen._asdict())
            raise typer.Exit(1 if seen.silent else 0)
