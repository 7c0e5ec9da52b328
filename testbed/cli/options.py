"""Options that several commands of `longreach` share, worded once."""

from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from foundation.command_options import usual_configs
from testbed.choices import ClockKind, ControllerKind, PoseForm
from testbed.reporting.console import writable
from vision_pc.config.choices import PositioningMethod, Setup


class SampleSource(NamedTuple):
    """Where samples come from."""

    file: Annotated[Path, typer.Argument(help="Samples (.json, .csv), or the hand's recording (TUM).")]
    camera_file: Annotated[Path | None, typer.Argument(help="The camera's recording (TUM).")] = None
    setup: Annotated[Setup | None, typer.Option("--setup", help="Where the camera is mounted.")] = None
    camera_in_target: Annotated[
        bool, typer.Option("--camera-in-target", help="The camera's poses are of the camera in the target.")
    ] = False
    normalise: Annotated[bool, typer.Option("--normalise", help="Accept quaternions of any norm.")] = False
    offset_s: Annotated[
        str, typer.Option("--offset-s", help="Seconds to add to the camera's clock, or 'estimate'.")
    ] = "0"
    marker_id: Annotated[
        int | None, typer.Option("--marker-id", help="Refuse samples of another marker.")
    ] = None


class PicturedBoard(NamedTuple):
    """The board in the pictures."""

    columns: Annotated[int, typer.Option(min=2, help="Inner corners across; squares with --charuco.")] = 9
    rows: Annotated[int, typer.Option(min=2, help="Inner corners down; squares with --charuco.")] = 6
    square_mm: Annotated[float, typer.Option(min=0.1, help="Side of a square.")] = 25.0
    charuco: Annotated[bool, typer.Option("--charuco", help="The board is a ChArUco board.")] = False
    marker_mm: Annotated[float, typer.Option(min=0.1, help="Side of a ChArUco board's marker.")] = 18.0
    dictionary: Annotated[str, typer.Option(help="Its dictionary, as OpenCV names it.")] = "DICT_5X5_100"
    target: Annotated[
        Path | None, typer.Option(help="Kalibr's file of an AprilGrid, which is the board instead.")
    ] = None


class PoseLines(NamedTuple):
    """How the robot's poses are written."""

    poses_as: Annotated[PoseForm, typer.Option("--poses", help="Whose way of writing poses.")] = (
        PoseForm.QUATERNION_XYZW
    )
    euler: Annotated[
        str, typer.Option(help="Order of Euler angles: ZYX about turned axes, zyx about fixed ones.")
    ] = "ZYX"
    hand_unit: Annotated[
        str | None, typer.Option(help="m, cm or mm; by default mm of kuka and abb, else m.")
    ] = None


ConfigDir = Annotated[
    Path, typer.Option("--config-dir", help="Configuration; `longreach init` copies what is shipped.")
]
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

DEFAULT_CONFIG = usual_configs()


class StartOptions(NamedTuple):
    """Where the services run, and what they may."""

    free_ports: Annotated[
        bool, typer.Option("--free-ports", help="Use any free ports instead of the configured ones.")
    ] = False
    allow_faults: Annotated[
        bool, typer.Option("--allow-faults", help="Let the plant's HTTP face for faults break things.")
    ] = False
    show_truth: Annotated[
        bool, typer.Option("--show-truth", help="Let the console draw where the emulator's arm really is.")
    ] = False
    runs: Annotated[Path, typer.Option("--out", help="Where directories of runs are made.")] = Path("runs")
    controller: Annotated[
        ControllerKind, typer.Option(help="In Python, or in structured text, compiled: plc/*.st.")
    ] = ControllerKind.PYTHON
    clock: Annotated[
        ClockKind | None,
        typer.Option(
            help="plant: a slow machine is slow, and nothing comes late; wall: in real time. By default the "
            "plant's, where no part is somebody else's."
        ),
    ] = None
    pace: Annotated[
        float,
        typer.Option(min=0.0, help="The most times real time, by the plant's clock; 0: as fast as it can."),
    ] = 1.0
    foxglove: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65535,
            metavar="PORT",
            help="Show all live: to viewers, and figures at /metrics; 0: any.",
        ),
    ] = None


class DemoOptions(NamedTuple):
    """How the demonstration runs, and how far."""

    lockstep: Annotated[bool, typer.Option("--lockstep", help="In simulated time, without sockets.")] = False
    method: Annotated[
        PositioningMethod,
        typer.Option(help="corrected by odometry on the way, or the paper's, by trajectory matching."),
    ] = PositioningMethod.CORRECTED
    looks: Annotated[int, typer.Option(min=1, max=9, help="How many look-then-moves.")] = 1


class Disturbed(NamedTuple):
    """What is run and broken: the REST API's programs, docs/faults.md."""

    program: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[,KEY=VALUE]",
            help="Run this program after the orientation adjustment, in place of calibration and looks; "
            "repeatable.",
        ),
    ] = None
    fault: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND[,KEY=VALUE]",
            help="Break this at the start, such as encoder_jump,joint=lift,angle_mrad=5,start_after_s=20; "
            "repeatable.",
        ),
    ] = None


class OdometryOptions(NamedTuple):
    """Where a recording's path goes, and what it is compared with."""

    trajectory: Annotated[
        Path, typer.Option("--out", help="Where the TUM trajectory goes.", callback=writable)
    ] = Path("trajectory.tum")
    rate_hz: Annotated[
        float, typer.Option(min=0.1, help="Pairs a second, where neither times.txt nor names tell.")
    ] = 10.0
    truth: Annotated[
        Path | None,
        typer.Option(help="True poses of the left camera (TUM, KITTI): prints ATE, RPE, scale and drift."),
    ] = None
