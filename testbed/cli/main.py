"""The `longreach` command: starts, shows and examines the parts put together."""

import os
import shutil
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from conformance.command import app as conformance_app
from foundation.command_options import shipped_configs, show_any_letter, unfolded
from protocol.errors import ConfigurationError
from testbed.choices import Timing
from testbed.cli import (
    arm,
    camera,
    export,
    hand_eye,
    recording,
    target,
    token,
)
from testbed.cli.options import (
    DEFAULT_CONFIG,
    ConfigDir,
    DemoOptions,
    Disturbed,
    JsonFile,
    OdometryOptions,
    Scenario,
    Seed,
    Settings,
    StartOptions,
)
from testbed.cli.root import PANEL, CommandApp, RootGroup, show_version
from testbed.reporting.console import promised

app = CommandApp(
    name="longreach",
    cls=RootGroup,
    no_args_is_help=True,
    rich_markup_mode="rich",
)


@app.callback()
def longreach(
    version: Annotated[
        bool,
        typer.Option("--version", help="Show the version and end.", callback=show_version, is_eager=True),
    ] = False,
) -> None:
    """Vision-guided precise positioning of long-reach hydraulic manipulators: the testbed's command."""


@app.command(rich_help_panel=PANEL["init"], epilog="Example: longreach init   then: edit configs/vision.yaml")
def init(
    directory: Annotated[
        Path, typer.Argument(metavar="[DIR]", help="Made; `configs` is found by itself.")
    ] = Path("configs"),
) -> None:
    """Copy the shipped configuration, to be edited: files, scenarios and arms."""
    if directory.exists():
        raise ConfigurationError("configuration.not_empty", f"{directory} is there: nothing was copied")
    shutil.copytree(shipped_configs(), promised(directory))
    typer.echo(f"{directory}: copied from {shipped_configs()}; --config-dir {directory}")


@app.command(
    rich_help_panel=PANEL["up"], epilog="Example: longreach up --scenario standard --seed 3 --allow-faults"
)
@unfolded
def up(
    start: StartOptions,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    scenario: Annotated[str | None, typer.Option(help="Draw the world from this scenario.")] = None,
    seed: Seed = 1,
    settings: Settings = None,
) -> None:
    """Start plant, controller and vision, watch them, and end them on Ctrl-C."""
    from testbed.realtime.up import run_up
    from testbed.scenarios.scenario import chosen_overrides, with_face

    overrides = chosen_overrides(config_dir, scenario, seed, settings or [])
    world = with_face(overrides, start.allow_faults, start.show_truth)
    timing = Timing(start.clock, start.pace)
    run_up(config_dir, world, start.free_ports, start.runs, start.foxglove, start.controller, timing)


@app.command(
    rich_help_panel=PANEL["replay"],
    epilog="Example: longreach replay runs/demo/vision_pc/vision.mcap",
)
def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording of the vision PC: vision.mcap.")],
    truth: Annotated[
        Path | None,
        typer.Option(
            help="The plant's recording to render pictures from; by default that of the same run, where FILE "
            "holds none."
        ),
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Run vision's perception again over a recording; exit status 1 unless all is as recorded.

    Every measurement is compared; the first that differs is told with both values.
    """
    from testbed.recordings.command import run_replay

    raise typer.Exit(0 if run_replay(file, truth, json_file) else 1)


@app.command(
    rich_help_panel=PANEL["commission"],
    epilog="Example: longreach commission --joints slew,lift --out runs/commission/monday",
)
@unfolded
def commission(
    joints: Annotated[
        str, typer.Option(help="Which joints, by name, in this order.")
    ] = "slew,lift,tilt,wrist1,wrist2,wrist3",
    directory: Annotated[
        Path, typer.Option("--out", help="The session: joints that are there are not tried out again.")
    ] = Path("runs/commission"),
    fault: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND[,KEY=VALUE]",
            help="Break this of the emulated arm at the start, such as valve_swapped,joint=tilt; repeatable.",
        ),
    ] = None,
    records: Annotated[
        Path | None,
        typer.Option(
            help="Take what a controller with controller.excitation.enabled=true tried out by itself: its "
            "--record-dir."
        ),
    ] = None,
    seed: Seed = 1,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    json_file: JsonFile = None,
) -> None:
    """Try out the emulated arm's valves, in simulated time, and write commissioned.yaml.


    Exit status 1 when a joint was broken off or its numbers are refused; what was found is kept.
    """
    from foundation.configuration import parse_overrides
    from testbed.commissioning.command import CommissionRequest, run_commission
    from testbed.scenarios.scenario import fault_orders

    overrides = parse_overrides(settings or [])
    names = [name.strip() for name in joints.split(",")]
    broken = fault_orders(fault or [])
    machine = config_dir, overrides, names, directory, seed
    request = CommissionRequest(*machine, json_file, records, broken)
    raise typer.Exit(0 if run_commission(request) else 1)


@app.command(
    rich_help_panel=PANEL["demo"],
    epilog="Example: longreach demo --seed 3   or: longreach demo --lockstep --seed 3 --json demo.json",
)
@unfolded
def demo(
    start: StartOptions,
    chosen: DemoOptions,
    disturbed: Disturbed,
    scenario: Scenario = "standard",
    seed: Seed = 1,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    json_file: JsonFile = None,
) -> None:
    """Bring the tool to the object; exit status 0 only within ±5 mm true error in x and y."""
    from testbed.demonstration.runs import run_demo, run_lockstep_demo
    from testbed.reporting.run_directory import Choice
    from testbed.scenarios.scenario import chosen_overrides, fault_orders, named_request, with_face

    programs = tuple(named_request(word) for word in disturbed.program or [])
    faults = fault_orders(disturbed.fault or [])
    breaks = start.allow_faults or bool(faults)
    world = chosen_overrides(config_dir, scenario, seed, settings or [])
    overrides = with_face(world, breaks, start.show_truth)
    chosen_run = scenario, seed, 1 if programs else chosen.looks, programs, faults
    choice = Choice(*chosen_run, chosen.method, start.controller, Timing(start.clock, start.pace))
    if chosen.lockstep:
        passed = run_lockstep_demo(config_dir, overrides, choice, start.runs, json_file)
    else:
        live = start.foxglove
        passed = run_demo(config_dir, overrides, choice, start.free_ports, start.runs, json_file, live)
    raise typer.Exit(0 if passed else 1)


@app.command(
    rich_help_panel=PANEL["odometry"],
    epilog="Example: longreach odometry --left image_0 --right image_1 --calib calib.txt --out path.tum",
)
@unfolded
def odometry(
    left: Annotated[Path, typer.Option(help="Directory of the left eye's rectified pictures.")],
    right: Annotated[Path, typer.Option(help="Directory of the right eye's.")],
    calib: Annotated[
        Path,
        typer.Option(
            help="YAML with fx_px, fy_px, cx_px, cy_px, baseline_m (and right_cx_px, width_px, height_px), "
            "KITTI's calib.txt with P0: and P1:, or of raw pairs any file that `longreach camera` reads."
        ),
    ],
    options: OdometryOptions,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    json_file: JsonFile = None,
) -> None:
    """The camera's path from a directory of rectified pairs; exit status 1 when a pair was lost.

    Beside the trajectory a CSV has a line a pair: map, loss and its cause, health, covariance. What comes
    after a gap that nothing bridges has a trajectory of its own.
    """
    from foundation.configuration import load, parse_overrides
    from testbed.cli.perception import run_odometry
    from vision_pc.config.vision import VisionConfig
    from vision_pc.shell.cameras.sequence import Recorded

    config = load(VisionConfig, config_dir / "vision.yaml", parse_overrides(settings or []).get("vision"))
    recorded = Recorded(left, right, calib, options.rate_hz)
    raise typer.Exit(0 if run_odometry(recorded, config, options, json_file) else 1)


@app.command(
    rich_help_panel=PANEL["markers"],
    epilog="Example: longreach markers left.png --right right.png --number 1 --number 2 --out seen",
)
def markers(
    pictures: Annotated[list[Path], typer.Argument(metavar="PICTURE…", help="Of one eye, or directories.")],
    right: Annotated[
        list[Path] | None,
        typer.Option(help="The right eye's, in the same order; repeatable."),
    ] = None,
    dictionary: Annotated[
        str, typer.Option(help="As in markers.dictionary of vision.yaml.")
    ] = "DICT_5X5_1000",
    number: Annotated[list[int] | None, typer.Option(help="A wanted number; repeatable.")] = None,
    directory: Annotated[
        Path | None, typer.Option("--out", help="Also draw what was found into this directory.")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Markers in pictures, without rig or controller; exit status 1 where one that is wanted is missing."""
    from testbed.cli.perception import run_markers

    found = run_markers(pictures, right or [], dictionary, number or [], directory, json_file)
    raise typer.Exit(0 if found else 1)


suites = CommandApp(help=conformance_app.info.help, no_args_is_help=True)
for one in conformance_app.registered_commands:
    suites.command(one.name, epilog=one.epilog)(one.callback)
GROUPS = {
    "recording": recording.app, "arm": arm.app, "camera": camera.app,
    "hand-eye": hand_eye.app, "conformance": suites, "export": export.app,
    "token": token.app,
}  # fmt: skip
for name, group in GROUPS.items():
    app.add_typer(group, name=name, rich_help_panel=PANEL[name])
app.command(
    "target",
    rich_help_panel=PANEL["target"],
    epilog="Example: longreach target --marker 582 --size-mm 50 --out marker.pdf",
)(target.target)
for point in entry_points(
    group="longreach.commands"
):  # of other distributions: the laboratory's `experiment`
    if find_spec(point.module.partition(".")[0]) is not None:
        app.add_typer(point.load().app, name=point.name, rich_help_panel=PANEL[point.name])


def main() -> None:
    """Run the command line."""
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")  # its warnings say what our refusals say
    show_any_letter()
    app()


if __name__ == "__main__":
    main()
