"""``python -m controller``: the PLC stand-in as a process. Prints one JSON line when it serves."""

import argparse
import asyncio
import sys
from pathlib import Path

import uvloop

from controller.config import ControllerConfig
from controller.shell.event_log import EventLog
from controller.shell.service import ControllerService, Options
from foundation.configuration import load, parse_overrides
from nominal_arm.description import NominalArm
from protocol.errors import LongreachError

_EPILOG = "example: python -m controller --config-dir configs --set controller.cycle_ms=2 --record-dir run"


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m controller", description=__doc__, epilog=_EPILOG)
    parser.add_argument(
        "--config-dir", type=Path, default=Path("configs"), help="directory of arm.yaml and controller.yaml"
    )
    parser.add_argument(
        "--set",
        action="extend",
        nargs="+",
        default=[],
        metavar="FILE.KEY=VALUE",
        help="override a key; repeatable; keys of other services' files are left to them",
    )
    parser.add_argument("--record-dir", type=Path, help="dump the last scans here after a fault")
    parser.add_argument(
        "--statistics", type=Path, metavar="FILE", help="write figures as JSON every 10 s and at the end"
    )
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Exit status: 0 ended when asked to, 2 bad configuration or busy port, 1 a bug."""
    arguments = _arguments(argv)
    try:
        overrides = parse_overrides(arguments.set)
        arm = load(NominalArm, arguments.config_dir / "arm.yaml", overrides.get("arm"))
        config = load(ControllerConfig, arguments.config_dir / "controller.yaml", overrides.get("controller"))
        log = EventLog()
        service = ControllerService(arm, config, Options(arguments.record_dir, arguments.statistics), log)
    except LongreachError as error:
        print(f"controller: {error.cause}: {error}", file=sys.stderr)
        return 2
    try:
        with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
            runner.run(service.run())
    finally:
        log.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
