"""Options that several commands of `longreach` share, worded once."""

from pathlib import Path
from typing import Annotated

import typer

from testbed.reporting.console import writable

ConfigDir = Annotated[Path, typer.Option("--config-dir", help="Where the configuration files are.")]
Scenario = Annotated[str, typer.Option(help="Which of CONFIG_DIR/scenarios to draw the world from.")]
Count = Annotated[int, typer.Option("--runs", min=1, help="How many seeds, from --seed on.")]
Seed = Annotated[int, typer.Option(min=0, help="The same seed is the same world; the first of several.")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", help="Override one key, such as plant.payload.mass_kg=30; repeatable."),
]
Scheduler = Annotated[
    str | None,
    typer.Option(help="A Dask scheduler that is there, such as tcp://host:8786; else workers are started."),
]
Directory = Annotated[Path, typer.Option(help="Where rows are kept; what is there is not run again.")]
Out = Annotated[Path, typer.Option("--out", help="Rows, figures, report; rows there are not measured again.")]
JsonFile = Annotated[
    Path | None,
    typer.Option("--json", help="Also write every printed figure to this file.", callback=writable),
]

DEFAULT_CONFIG = Path("configs")
