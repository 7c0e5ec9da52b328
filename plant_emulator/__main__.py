"""``python -m plant_emulator``: the physical world as a process. Prints one JSON line when it serves."""

import sys

from foundation.event_log import EventLog
from foundation.service_main import ServiceOptions, ServiceProgram, Switch, service_main
from plant_emulator.config.service import load_plant_side
from plant_emulator.shell.service import PlantService


def _make_service(options: ServiceOptions, log: EventLog) -> PlantService:
    return PlantService(load_plant_side(options.config_dir, options.overrides), options, log)


PROGRAM = ServiceProgram(
    name="plant_emulator",
    description=__doc__,
    example=("python -m plant_emulator --config-dir configs --set plant.payload.mass_kg=50 --record-dir run"),
    files="plant.yaml, scene.yaml and plant_service.yaml",
    records="the truth, truth.mcap,",
    make=_make_service,
    switches=(
        Switch(
            "--allow-faults",
            "let the HTTP face at plant_service.fault_face break things",
            {"plant_service": {"fault_face": {"allowed": True}}},
        ),
    ),
)


def main(argv: list[str] | None = None) -> int:
    """Run the emulator; return its exit status, see ``service_main``."""
    return service_main(PROGRAM, argv)


if __name__ == "__main__":
    sys.exit(main())
