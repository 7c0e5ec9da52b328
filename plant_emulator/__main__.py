"""``python -m plant_emulator``: the physical world as a process. Prints one JSON line when it serves."""

import argparse
import asyncio
import json
import logging
import sys
import time
from pathlib import Path
from typing import Any

import uvloop

from foundation.configuration import merged, parse_overrides
from plant_emulator.config.service import load_plant_side
from plant_emulator.shell.service import Options, PlantService
from protocol.errors import LongreachError

_EPILOG = (
    "example: python -m plant_emulator --config-dir configs --set plant.payload.mass_kg=50 --record-dir run"
)


class _JsonLines(logging.Formatter):
    """One JSON object a line."""

    def format(self, record: logging.LogRecord) -> str:
        """The line for ``record``; ``monotonic_ns`` fits the recording's log times."""
        fields = {
            "monotonic_ns": time.monotonic_ns(),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if record.exc_info:
            fields["exception"] = self.formatException(record.exc_info)
        return json.dumps(fields)


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m plant_emulator", description=__doc__, epilog=_EPILOG)
    parser.add_argument(
        "--config-dir", type=Path, default=Path("configs"), help="directory of the YAML files"
    )
    parser.add_argument(
        "--set",
        action="extend",
        nargs="+",
        default=[],
        metavar="FILE.KEY=VALUE",
        help="override a key; repeatable",
    )
    parser.add_argument("--record-dir", type=Path, help="write the truth to truth.mcap in this directory")
    parser.add_argument("--statistics", type=Path, metavar="FILE", help="write figures as JSON at the end")
    parser.add_argument(
        "--allow-faults",
        action="store_true",
        help="let the HTTP face at plant_service.fault_face break things",
    )
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Exit status: 0 ended when asked to, 1 a part failed, 2 bad configuration or busy port."""
    arguments = _arguments(argv)
    handler = logging.StreamHandler()
    handler.setFormatter(_JsonLines())
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    try:
        overrides: dict[str, Any] = parse_overrides(arguments.set)
        if arguments.allow_faults:
            overrides = merged(overrides, {"plant_service": {"fault_face": {"allowed": True}}})
        config = load_plant_side(arguments.config_dir, overrides)
        options = Options(arguments.record_dir, arguments.statistics)
        with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
            return runner.run(PlantService(config, options).run())
    except LongreachError as error:
        print(f"plant_emulator: {error.cause}: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
