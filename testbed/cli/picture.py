"""`longreach picture machine`: the arm from the side."""

from pathlib import Path
from typing import Annotated

import typer

from foundation.command_options import usual_configs
from testbed.cli.root import CommandApp
from testbed.reporting.console import out, writable

app = CommandApp(help="Pictures that explain.", no_args_is_help=True)
ConfigDir = Annotated[Path, typer.Option("--config-dir", help="Where the configuration files are.")]
DEFAULT_CONFIG = usual_configs()


@app.callback()
def _pictures() -> None:
    """Pictures that explain."""


@app.command("machine", epilog="Example: longreach picture machine --out docs/images/machine.png")
def machine_command(
    path: Annotated[
        Path, typer.Option("--out", help="Where the picture goes (PNG or SVG).", callback=writable)
    ],
    config_dir: ConfigDir = DEFAULT_CONFIG,
) -> None:
    """The nominal arm from the side at its start pose, with the frames B, T, C, M and O."""
    from testbed.pictures.machine import draw_machine
    from testbed.scenarios.scenario import load_settings

    draw_machine(load_settings(config_dir, {}), path)
    out.print(f"{path}: {path.stat().st_size / 1000:.0f} kB", highlight=False)
