"""`longreach picture effects`: what each effect of camera and scene does, in pictures and in grey levels."""

from pathlib import Path
from typing import Annotated

import typer

from foundation.command_options import usual_configs
from testbed.reporting.console import out, writable

app = typer.Typer(help="Pictures that explain.", no_args_is_help=True)
ConfigDir = Annotated[Path, typer.Option("--config-dir", help="Where the configuration files are.")]
DEFAULT_CONFIG = usual_configs()


@app.callback()
def _pictures() -> None:
    """Pictures that explain."""


@app.command("effects", epilog="Example: longreach picture effects --out runs/effects")
def effects_command(
    directory: Annotated[Path, typer.Option("--out", help="Where the pictures go.")],
    config_dir: ConfigDir = DEFAULT_CONFIG,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Also write every printed figure to this file.")
    ] = None,
) -> None:
    """One picture per effect of camera and scene, off and on, and all of them on one sheet."""
    from testbed.pictures.effects import draw_effects

    draw_effects(config_dir, directory, json_file)


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


@app.command("run", epilog="Example: longreach picture run --out docs/images/run.webp --seed 1")
def run_command(
    path: Annotated[
        Path, typer.Option("--out", help="Where the animation goes (WebP or GIF).", callback=writable)
    ],
    scenario: Annotated[str, typer.Option(help="Draw the world from this scenario.")] = "standard",
    seed: Annotated[int, typer.Option(min=0, help="The same seed is the same world.")] = 1,
    config_dir: ConfigDir = DEFAULT_CONFIG,
) -> None:
    """One run in simulated time: the arm from the side, what its camera sees, the true error over time."""
    from testbed.pictures.film import filmed, write_film
    from testbed.reporting.console import bars
    from testbed.scenarios.scenario import chosen_overrides, load_settings

    settings = load_settings(config_dir, chosen_overrides(config_dir, scenario, seed, []))
    with bars() as shown:
        stills, rests = filmed(settings, seed, 2, shown)
    write_film(settings, stills, rests, path)
    out.print(f"{path}: {len(stills)} pictures, {path.stat().st_size / 1000:.0f} kB", highlight=False)
