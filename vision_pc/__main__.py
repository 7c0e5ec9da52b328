"""``python -m vision_pc``: eyes and decisions as a process. Prints one JSON line when it serves."""

import sys
from collections.abc import Sequence
from typing import Any

from foundation.configuration import load
from foundation.event_log import EventLog
from foundation.service_main import ServiceOptions, ServiceProgram, service_main
from nominal_arm.description import NominalArm
from vision_pc.application.program import Program
from vision_pc.application.programs import PROGRAMS
from vision_pc.config.vision import VisionConfig
from vision_pc.shell.service import VisionService


def main(argv: list[str] | None = None, programs: Sequence[Program[Any, Any]] = PROGRAMS) -> int:
    """Run the vision PC with ``programs``; return its exit status, see ``service_main``."""

    def made(options: ServiceOptions, log: EventLog) -> VisionService:
        files, overrides = options.config_dir, options.overrides
        arm = load(NominalArm, files / "arm.yaml", overrides.get("arm"))
        config = load(VisionConfig, files / "vision.yaml", overrides.get("vision"))
        return VisionService(config, arm, options, log, programs)

    service = ServiceProgram(
        name="vision_pc",
        description=__doc__,
        example="python -m vision_pc --config-dir configs --set vision.api.port=8010 --record-dir run",
        files="arm.yaml and vision.yaml",
        records="vision.mcap, events.jsonl and the pictures of looks",
        make=made,
        follows="vision_pc",
    )
    return service_main(service, argv)


if __name__ == "__main__":
    sys.exit(main())
