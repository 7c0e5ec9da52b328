"""`longreach arm`: which arms there are, whether one is right, and how to begin one of one's own."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from protocol.errors import ConfigurationError
from testbed.cli.options import DEFAULT_CONFIG, ConfigDir, JsonFile
from testbed.cli.root import CommandApp
from testbed.reporting.console import noted, out, promised, table, writable, write_json

if TYPE_CHECKING:
    from testbed.reporting.checks import HealthCheck

app = CommandApp(help="Arms: which there are, whether one is right, one of your own.", no_args_is_help=True)
DEFAULT_ARM = "default"
Chosen = Annotated[str, typer.Argument(metavar="[NAME|DIR]", help="Of CONFIG_DIR/arms, or a directory.")]


@app.command("list", epilog="Example: longreach arm list")
def list_arms(config_dir: ConfigDir = DEFAULT_CONFIG, json_file: JsonFile = None) -> None:
    """The arms that --arm takes by name: what each is, and its reach; of one that cannot be read, why."""
    from foundation.foreign_text import read_each
    from nominal_arm.dimensions import boom_dimensions
    from testbed.scenarios.arms import arm_directory, arm_names
    from testbed.scenarios.scenario import load_settings

    found, broken = read_each(
        arm_names(config_dir), lambda name: load_settings(arm_directory(config_dir, name), {}).arm
    )
    booms = [(name, arm.name, boom_dimensions(arm)) for name, arm in found]
    rows = [(name, what, boom.boom + boom.forearm + boom.wrist_to_tool) for name, what, boom in booms]
    cells = [(name, what, f"{reach:.2f}") for name, what, reach in rows]
    out.print(table("arms", ("--arm", "arm.yaml's name", "lift pivot to tool, m"), cells))
    noted(broken)
    keys = ("arm", "name", "reach_m")
    write_json(json_file, {"arms": [dict(zip(keys, row, strict=True)) for row in rows], "broken": broken})


@app.command("check", epilog="Example: longreach arm check long_crane")
def check(
    chosen: Chosen = DEFAULT_ARM, config_dir: ConfigDir = DEFAULT_CONFIG, json_file: JsonFile = None
) -> None:
    """Whether drawing, machine, controller and scene agree, a line each; exit status 1 when one does not."""
    from testbed.reporting.checks import checks_table
    from testbed.scenarios.arms import arm_directory

    findings = list(_findings(arm_directory(config_dir, chosen)))
    out.print(checks_table(f"arm {chosen}", findings))
    write_json(json_file, {"arm": chosen, "findings": [finding._asdict() for finding in findings]})
    raise typer.Exit(1 if any(finding.verdict == "failed" for finding in findings) else 0)


def _findings(directory: Path) -> "Iterator[HealthCheck]":
    """Each file that cannot be read, or what the files say of each other."""
    from testbed.arms import check_arm
    from testbed.reporting.checks import HealthCheck
    from testbed.scenarios.scenario import load_settings, loaders

    wrong = []
    for name, load in loaders(directory, {}).items():
        try:
            load()
        except ConfigurationError as error:
            wrong.append(HealthCheck(f"{name}.yaml", "failed", str(error), error.cause))
    yield from wrong or check_arm(load_settings(directory, {}))


@app.command("new", epilog="Example: longreach arm new rock_breaker --like long_crane")
def new(
    chosen: Annotated[str, typer.Argument(metavar="NAME|DIR", help="Made in CONFIG_DIR/arms, or there.")],
    like: Annotated[str, typer.Option(help="The arm to begin with.")] = DEFAULT_ARM,
    config_dir: ConfigDir = DEFAULT_CONFIG,
) -> None:
    """Make a directory with what differs from arm to arm, copied from one that is there, to be edited."""
    from testbed.arms import begin_arm
    from testbed.scenarios.arms import ARMS_DIR, arm_directory
    from testbed.scenarios.scenario import load_settings

    source = arm_directory(config_dir, like)
    directory = Path(chosen) if "/" in chosen else config_dir / ARMS_DIR / chosen
    for path in begin_arm(promised(directory), source, load_settings(source, {})):
        out.print(str(path), highlight=False, soft_wrap=True)
    out.print(f"edit them, then: longreach arm check {chosen}", style="dim", highlight=False, soft_wrap=True)


@app.command("draw", epilog="Example: longreach arm draw long_crane --out long_crane.png")
def draw(
    chosen: Chosen = DEFAULT_ARM,
    path: Annotated[Path, typer.Option("--out", help="PNG or SVG.", callback=writable)] = Path("arm.png"),
    config_dir: ConfigDir = DEFAULT_CONFIG,
) -> None:
    """The arm from the side at its start pose, the object, the wrist's reach and the tool's workspace."""
    from testbed.pictures.machine import draw_machine
    from testbed.scenarios.arms import arm_directory
    from testbed.scenarios.scenario import load_settings

    draw_machine(load_settings(arm_directory(config_dir, chosen), {}), path)
    out.print(f"{path}: {path.stat().st_size / 1000:.0f} kB", highlight=False)
