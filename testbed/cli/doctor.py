"""`longreach doctor`: shows every check with its verdict, and what to do about what is wrong."""

from collections.abc import Iterator
from pathlib import Path

from rich.table import Table
from rich.text import Text

from foundation.configuration import parse_overrides
from plant_emulator.core.faults.kinds import FAULTS
from protocol.errors import ConfigurationError
from testbed.arms import check_arm
from testbed.realtime import doctor
from testbed.realtime.doctor import HealthCheck, arm_check
from testbed.realtime.launch import ports_in_use
from testbed.reporting.console import bars, out, words, write_json
from testbed.scenarios.scenario import Overrides, Settings, load_settings, loaders
from vision_pc.application.programs import PROGRAMS

_STYLES = {"ok": "green", "warning": "yellow", "failed": "bold red"}
_LOCK = Path("requirements.lock")


def examine(config_dir: Path, assignments: list[str], runs: Path, json_file: Path | None) -> bool:
    """Whether nothing failed; prints the checks as a table and writes them to ``json_file``."""
    overrides = parse_overrides(assignments)
    checks: list[HealthCheck] = []
    with bars() as shown, shown.step("examining") as bar:
        for check in _all_checks(config_dir, overrides, runs):
            checks.append(check)
            bar.update(len(checks) / 20.0, check.name)
    table = Table("check", "verdict", "found", "advice", title="doctor", title_justify="left")
    for check in checks:
        table.add_row(check.name, Text(check.verdict, _STYLES[check.verdict]), check.found, check.advice)
    out.print(table)
    write_json(json_file, {"checks": [check._asdict() for check in checks]})
    return all(check.verdict != "failed" for check in checks)


def _all_checks(config_dir: Path, overrides: Overrides, runs: Path) -> Iterator[HealthCheck]:
    yield from doctor.machine_checks(_LOCK, runs)
    for name, load in loaders(config_dir, overrides).items():
        yield doctor.configuration_check(name, load)
    try:
        settings = load_settings(config_dir, overrides)
    except ConfigurationError:
        return  # told above; without a configuration there are no ports to look at
    yield _peers_check(settings)
    yield arm_check(settings.arm, settings.vision.link)
    yield _drawing_check(settings)
    for use in ports_in_use(settings):
        yield doctor.port_check(use)


def _drawing_check(settings: Settings) -> HealthCheck:
    """Whether arm.yaml draws the machine that is emulated; a real one needs no plant.yaml."""
    wrong = [one for one in check_arm(settings) if one.verdict != "ok"]
    found = "; ".join(f"{one.name}: {one.found}" for one in wrong) or "as the emulated machine is built"
    advice = "longreach arm check tells which keys; a drawing of a real machine may differ" if wrong else ""
    return HealthCheck("drawing", "warning" if wrong else "ok", found, advice)


def _peers_check(settings: Settings) -> HealthCheck:
    """Whether each service looks for its peer where that listens."""
    service, controller, vision = settings.plant_service, settings.controller, settings.vision
    pairs = (
        ("controller.plant_link.port", controller.plant_link.port, service.modbus.port),
        ("vision.camera.stream.port", vision.camera.stream.port, service.camera_stream.port),
        ("vision.link.port", vision.link.port, controller.reference_link.port),
    )
    wrong = [f"{key} = {port}, its peer listens on {peer}" for key, port, peer in pairs if port != peer]
    return HealthCheck("links", "failed" if wrong else "ok", "; ".join(wrong) or "each finds its peer")


def list_programs(json_file: Path | None) -> None:
    """Print what can be run and what can be broken."""
    found = {
        "programs": [(program.name, program.title) for program in PROGRAMS],
        "disturbances": [(name, (kind.__doc__ or "").partition("\n")[0]) for name, kind in FAULTS.items()],
    }
    for what, rows in found.items():
        out.print(words(what, ("name", "what it does"), rows))
    figures = {what: [{"name": name, "shows": shows} for name, shows in rows] for what, rows in found.items()}
    write_json(json_file, figures)
