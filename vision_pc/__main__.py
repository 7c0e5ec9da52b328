"""``python -m vision_pc``: eyes and decisions as a process. Prints one JSON line when it serves."""

import sys
from collections.abc import Sequence
from typing import Any

from foundation.configuration import load
from foundation.event_log import EventLog
from foundation.service_main import ServiceOptions, ServiceProgram, service_main
from vision_pc.application.program import Program
from vision_pc.application.programs import PROGRAMS
from vision_pc.config.vision import VisionConfig
from vision_pc.shell.service import VisionService


def main(argv: list[str] | None = None, programs: Sequence[Program[Any, Any]] = PROGRAMS) -> int:
    """Run the vision PC with ``programs``; return its exit status, see ``service_main``."""

    def made(options: ServiceOptions, log: EventLog) -> VisionService:
        config = load(VisionConfig, options.config_dir / "vision.yaml", options.overrides.get("vision"))
        return VisionService(config, options, log, programs)

    service = ServiceProgram(
        name="vision_pc",
        description=__doc__,
        example="python -m vision_pc --config-dir configs --set vision.api.port=8010 --record-dir run",
        files="vision.yaml",
        records="events.jsonl and the pictures of looks",
        make=made,
    )
    return service_main(service, argv)


if __name__ == "__main__":
    sys.exit(main())
