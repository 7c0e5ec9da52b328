"""`longreach config`: what can be set."""

from typing import Annotated

import typer
from rich.markup import escape
from rich.padding import Padding
from rich.text import Text

from protocol.errors import ConfigurationError
from testbed.cli.options import DEFAULT_CONFIG, ConfigDir, JsonFile
from testbed.cli.root import CommandApp
from testbed.reporting.console import out, write_json

app = CommandApp(help="Every key that can be set: value, unit, limits, who sets it.", no_args_is_help=True)


@app.callback()
def config() -> None:
    """Every key that can be set: value, unit, limits, who sets it."""


@app.command("list", epilog="Example: longreach config list look   or: longreach config list 'vision.look.*'")
def list_keys(
    pattern: Annotated[
        str, typer.Argument(metavar="[PATTERN]", help="Part of the key, or a pattern with *.")
    ] = "",
    config_dir: ConfigDir = DEFAULT_CONFIG,
    json_file: JsonFile = None,
) -> None:
    """Keys with value, unit, limits, what the file says ([S] published, [M] measured …), who sets them."""
    from testbed.scenarios.configuration_keys import described_keys

    found = described_keys(config_dir, pattern)
    if not found:
        why = f"no key holds {pattern!r}; `longreach config list` without a pattern prints all"
        raise ConfigurationError("configuration.unknown_key", why)
    for one in found:
        out.print(f"[bold]{escape(one.key)}[/] = {escape(one.value)} {one.unit}".rstrip(), highlight=False)
        says = "; ".join(filter(None, (one.allowed, one.comment, *_set_by(one.set_by))))
        out.print(Padding(Text(says, "dim"), (0, 0, 0, 4)))
    write_json(json_file, {"keys": [one._asdict() for one in found]})


def _set_by(files: tuple[str, ...]) -> tuple[str, ...]:
    return (f"set by {', '.join(files)}",) if files else ()
