"""``python -m vision_pc``: eyes and decisions as a process. Prints one JSON line when it serves."""

import argparse
import asyncio
import sys
from pathlib import Path

import uvloop

from foundation.configuration import load, parse_overrides
from protocol.errors import LongreachError
from vision_pc.config.vision import VisionConfig
from vision_pc.shell.service import Options, VisionService

_EPILOG = "example: python -m vision_pc --config-dir configs --set vision.api.port=8010 --record-dir run"


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m vision_pc", description=__doc__, epilog=_EPILOG)
    parser.add_argument("--config-dir", type=Path, default=Path("configs"), help="directory of vision.yaml")
    parser.add_argument(
        "--set",
        action="extend",
        nargs="+",
        default=[],
        metavar="FILE.KEY=VALUE",
        help="override a key; repeatable; keys of other services' files are left to them",
    )
    parser.add_argument("--record-dir", type=Path, help="write events.jsonl and the pictures of looks here")
    parser.add_argument(
        "--statistics", type=Path, metavar="FILE", help="write figures as JSON every 10 s and at the end"
    )
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Exit status: 0 ended when asked to, 2 bad configuration or busy port, 1 a bug."""
    arguments = _arguments(argv)
    try:
        overrides = parse_overrides(arguments.set)
        config = load(VisionConfig, arguments.config_dir / "vision.yaml", overrides.get("vision"))
        service = VisionService(config, Options(arguments.record_dir, arguments.statistics))
    except LongreachError as error:
        print(f"vision_pc: {error.cause}: {error}", file=sys.stderr)
        return 2
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(service.run())
    return 0


if __name__ == "__main__":
    sys.exit(main())
