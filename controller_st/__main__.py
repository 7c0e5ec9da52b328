"""``python -m controller_st``: the controller in structured text as a process, in the usual shell."""

import sys

from controller.config import ControllerConfig
from controller.shell.service import ControllerService
from controller_st.parts import text_parts
from foundation.configuration import load
from foundation.event_log import EventLog
from foundation.service_main import ServiceOptions, ServiceProgram, service_main
from nominal_arm.description import NominalArm


def _make_service(options: ServiceOptions, log: EventLog) -> ControllerService:
    files, overrides = options.config_dir, options.overrides
    arm = load(NominalArm, files / "arm.yaml", overrides.get("arm"))
    config = load(ControllerConfig, files / "controller.yaml", overrides.get("controller"))
    return ControllerService(arm, config, options, log, text_parts)


PROGRAM = ServiceProgram(
    name="controller_st",
    description=__doc__,
    example="python -m controller_st --config-dir configs --set controller.cycle_ms=2 --record-dir run",
    files="arm.yaml and controller.yaml",
    records="the last scans after a fault",
    make=_make_service,
    live="controller",
)


def main(argv: list[str] | None = None) -> int:
    """Run the controller; return its exit status, see ``service_main``."""
    return service_main(PROGRAM, argv)


if __name__ == "__main__":
    sys.exit(main())
