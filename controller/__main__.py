"""``python -m controller``: the PLC stand-in as a process. Prints one JSON line when it serves."""

import sys

from controller.config import ControllerConfig
from controller.shell.service import ControllerService
from foundation.configuration import load
from foundation.event_log import EventLog
from foundation.service_main import ServiceOptions, ServiceProgram, service_main
from nominal_arm.description import NominalArm


def _make_service(options: ServiceOptions, log: EventLog) -> ControllerService:
    files, overrides = options.config_dir, options.overrides
    arm = load(NominalArm, files / "arm.yaml", overrides.get("arm"))
    config = load(ControllerConfig, files / "controller.yaml", overrides.get("controller"))
    return ControllerService(arm, config, options, log)


PROGRAM = ServiceProgram(
    name="controller",
    description=__doc__,
    example="python -m controller --config-dir configs --set controller.cycle_ms=2 --record-dir run",
    files="arm.yaml and controller.yaml",
    records="the last scans after a fault",
    make=_make_service,
    follows="controller",
)


def main(argv: list[str] | None = None) -> int:
    """Run the controller; return its exit status, see ``service_main``."""
    return service_main(PROGRAM, argv)


if __name__ == "__main__":
    sys.exit(main())
