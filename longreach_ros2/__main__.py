"""``longreach-ros2``: the arm in ROS 2, in the vision PC's place or with an emulated machine, or to watch."""

import argparse
import importlib.util
import math
import sys
from pathlib import Path
from typing import Any

from foundation.command_options import host_and_port, usual_configs
from foundation.configuration import load, merged, parse_overrides
from foundation.event_log import process_log
from nominal_arm.description import NominalArm
from protocol.errors import ConfigurationError, LongreachError
from vision_pc.config.vision import VisionConfig

_NAME = "longreach_ros2"
_REFUSED = 2


def main(argv: list[str] | None = None) -> int:
    """Run a node until SIGTERM or SIGINT; return the exit status: 0 in good order, 2 refused to start."""
    parser = _parser()
    known, for_ros = _split(sys.argv[1:] if argv is None else argv)
    arguments = parser.parse_args(known)
    try:
        _check_ros()
        _run(arguments, for_ros)
    except LongreachError as error:
        print(f"{_NAME}: {error.cause}: {error}", file=sys.stderr)
        return _REFUSED
    return 0


def _parser() -> argparse.ArgumentParser:
    example = "example: longreach-ros2 --controller 127.0.0.1:47000"
    parser = argparse.ArgumentParser("longreach-ros2", None, __doc__, example)
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument(
        "--controller", metavar="HOST:PORT", help="drive the arm behind this controller (vision.link)"
    )
    mode.add_argument(
        "--watch", metavar="URL", help="watch a live face, such as ws://127.0.0.1:8765; move nothing"
    )
    mode.add_argument(
        "--lockstep",
        action="store_true",
        help="drive an emulated machine in this process, and publish /clock",
    )
    parser.add_argument(
        "--pace", type=float, default=1.0, help="of --lockstep: times real time; 0: as fast as it is computed"
    )
    parser.add_argument("--no-tf", action="store_true", help="leave /tf to a robot_state_publisher")
    parser.add_argument("--camera", action="store_true", help="show the camera of vision.camera too")
    parser.add_argument(
        "--config-dir", type=Path, default=usual_configs(), help="directory of arm.yaml and vision.yaml"
    )
    parser.add_argument(
        "--set", action="extend", nargs="+", default=[], metavar="FILE.KEY=VALUE", help="override a key"
    )
    return parser


def _split(argv: list[str]) -> tuple[list[str], list[str]]:
    at = argv.index("--ros-args") if "--ros-args" in argv else len(argv)
    return argv[:at], argv[at:]


def _check_ros() -> None:
    """Raise ConfigurationError when there is no ROS 2 in this Python."""
    needed = ("rclpy", "control_msgs", "tf2_msgs", "sensor_msgs", "trajectory_msgs")
    missing = [name for name in needed if importlib.util.find_spec(name) is None]
    if missing:
        words = "source ROS 2 (setup.bash) first, in the Python that longreach is installed in"
        raise ConfigurationError("configuration.no_ros", f"{', '.join(missing)}: not found here; {words}")


def _run(arguments: argparse.Namespace, for_ros: list[str]) -> None:
    overrides = parse_overrides(arguments.set)
    if arguments.controller is not None:
        host, port = host_and_port(arguments.controller, f"--controller {arguments.controller!r}")
        overrides = merged(overrides, {"vision": {"link": {"host": host, "port": port}}})
    files = arguments.config_dir
    if arguments.lockstep:
        _check_lockstep(arguments)
        _run_lockstep(files, overrides, arguments, for_ros)
        return
    arm = load(NominalArm, files / "arm.yaml", overrides.get("arm"))
    config = load(VisionConfig, files / "vision.yaml", overrides.get("vision"))
    from longreach_ros2 import running  # rclpy is imported here alone

    with process_log(_NAME) as log:
        if arguments.watch is None:
            tf, with_camera = not arguments.no_tf, arguments.camera
            running.run(running.drive(arm, config, log, tf=tf, with_camera=with_camera), for_ros)
        else:
            running.run(running.watch(arguments.watch, log), for_ros)


def _run_lockstep(
    files: Path, overrides: dict[str, dict[str, Any]], arguments: argparse.Namespace, for_ros: list[str]
) -> None:
    from longreach_ros2 import running  # with rclpy, and the emulator
    from longreach_ros2.lockstep import SimulatedMachine

    machine = SimulatedMachine(files, overrides)
    with process_log(_NAME) as log:
        running.run(running.simulate(machine, arguments.pace, log, tf=not arguments.no_tf), for_ros)


def _check_lockstep(arguments: argparse.Namespace) -> None:
    if arguments.camera:
        raise ConfigurationError(
            "configuration.bad_value", "--camera: a machine in --lockstep shows no pictures"
        )
    if not (math.isfinite(arguments.pace) and arguments.pace >= 0.0):
        words = "allowed are positive numbers, and 0 for as fast as it is computed"
        raise ConfigurationError("configuration.bad_value", f"--pace {arguments.pace:g}: {words}")


if __name__ == "__main__":
    sys.exit(main())
