"""``python -m controller_st``: the controller in structured text as a process, in the usual shell."""

import sys

from controller.config import ControllerConfig
from controller.core.scan_program import ScanProgram
from controller.shell.service import ControllerService
from controller_st.ads_device import AdsDevice
from controller_st.ads_port import AdsPort
from controller_st.parts import TextProgram, text_parts
from foundation.configuration import load
from foundation.event_log import EventLog
from foundation.service_main import ServiceOptions, ServiceProgram, service_main
from nominal_arm.description import NominalArm
from protocol.authentication import LinkKey
from protocol.server_session import ReferenceServer


def _make_service(options: ServiceOptions, log: EventLog) -> ControllerService:
    files, overrides = options.config_dir, options.overrides
    arm = load(NominalArm, files / "arm.yaml", overrides.get("arm"))
    config = load(ControllerConfig, files / "controller.yaml", overrides.get("controller"))

    def parts(
        arm: NominalArm, config: ControllerConfig, boot_id: int, key: LinkKey | None
    ) -> tuple[ScanProgram, ReferenceServer]:
        program, server = text_parts(arm, config, boot_id, key)
        if config.ads.port:
            program.after_scan = _ads(program, config, log).serve
        return program, server

    return ControllerService(arm, config, options, log, parts)


def _ads(program: TextProgram, config: ControllerConfig, log: EventLog) -> AdsPort:
    device = AdsDevice(
        program.memory, writable=config.ads.writable, least_cycle_ns=round(1e6 * config.cycle_ms)
    )
    port = AdsPort(device, config.ads.host, config.ads.port, log)
    host, number = port.address
    log.write("ads", host=host, port=number, writable=config.ads.writable, symbols=len(device.table.symbols))
    return port


PROGRAM = ServiceProgram(
    name="controller_st",
    description=__doc__,
    example="python -m controller_st --config-dir configs --set controller.cycle_ms=2 --record-dir run",
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
