"""Options that several commands of `longreach` share, worded once."""

from pathlib import Path
from typing import Annotated

import typer

from testbed.reporting.console import writable

ConfigDir = Annotated[Path, typer.Option("--config-dir", help="Where the configuration files are.")]
Scenario = Annotated[str, typer.Option(help="Which of CONFIG_DIR/scenarios to draw the world from.")]
Seed = Annotated[int, typer.Option(min=0, help="The same seed is the same world; the first of several.")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", help="Override one key, such as plant.payload.mass_kg=30; repeatable."),
]
JsonFile = Annotated[
    Path | None,
    typer.Option("--json", help="Also write every printed figure to this file.", callback=writable),
]

DEFAULT_CONFIG = Path("configs")
