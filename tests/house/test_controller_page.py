"""docs/controller.md and docs/parking.md against the code: states, faults, numbers, functions named."""

import importlib
import re
from pathlib import Path

from controller.config import ControllerConfig
from controller.core.group_states import TRANSITIONS, Stimulus
from controller.core.supervision import FAULTS
from controller.core.trajectories.path_survey import SAMPLES
from foundation.configuration import load
from protocol.axes_group import Mode
from protocol.datagram_layout import MAX_WAYPOINTS
from protocol.faults import FAULT_TEXTS, Reason, Severity

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "controller.md").read_text(encoding="utf-8")
PARKING_PAGE = (ROOT / "docs" / "parking.md").read_text(encoding="utf-8")
CONFIG = load(ControllerConfig, ROOT / "configs" / "controller.yaml")


def _words(name: str) -> str:
    return name.lower().replace("_", " ")


def _between(mark: str) -> str:
    match = re.search(rf"<!-- {mark} -->\n(.*?)<!-- /{mark} -->", PAGE, re.DOTALL)
    assert match is not None
    return match.group(1).strip()


def state_table() -> str:
    """The page's table of states, from the transition table."""
    lines = [f"| stimulus | {' | '.join(_words(mode.name) for mode in Mode)} |"]
    lines.append("| --- " * (len(Mode) + 1) + "|")
    for stimulus in Stimulus:
        cells = []
        for mode in Mode:
            after = TRANSITIONS[mode, stimulus]
            reason = "" if after.reason is Reason.ACCEPTED else f" ({_words(after.reason.name)})"
            cells.append(f"{'–' if after.mode is mode else _words(after.mode.name)}{reason}")
        lines.append(f"| {stimulus.name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def fault_table() -> str:
    """The page's table of faults, with the words of the written protocol."""
    lines = ["| fault | when | reaction |", "| --- | --- | --- |"]
    for row in FAULTS:
        reaction = "stop" if row.reaction.severity is Severity.STOP else "emergency"
        lines.append(f"| `{row.code.name}` | {FAULT_TEXTS[row.code]} | {reaction} |")
    return "\n".join(lines)


def test_the_table_of_states_is_the_transition_table() -> None:
    assert _between("states") == state_table()


def test_the_table_of_faults_is_the_supervision_s() -> None:
    assert _between("faults") == fault_table()


def test_the_functions_of_one_scan_exist() -> None:
    section = PAGE.split("## One scan")[1].split("## Control")[0]
    named = re.findall(r"`([a-z_.]+)\.([a-z_]+)`", section)
    assert len(named) == 9
    for module, function in named:
        assert hasattr(importlib.import_module(f"controller.core.{module}"), function), f"{module}.{function}"


def test_the_numbers_of_the_page_are_the_configuration_s() -> None:
    stream, supervision, servo = CONFIG.streaming, CONFIG.supervision, CONFIG.pose_servo
    slow_ms = CONFIG.stream_close_ms - stream.ramp_ms
    flat = " ".join(PAGE.split())
    for text in (
        f"slowed from, centred at, in force at the plant by | {slow_ms:g}, {CONFIG.stream_close_ms:g}, "
        f"{stream.silence_ms:g} |",
        f"| cycle | {CONFIG.cycle_ms:g} |",
        f"| one Modbus exchange is given up after | {CONFIG.plant_link.timeout_ms:g} |",
        f"| {supervision.missed_exchanges * CONFIG.cycle_ms:g} ({supervision.missed_exchanges} exchanges) or "
        f"{supervision.silence_ms:g} of silence |",
        f"| reference link counts as silent after | {CONFIG.reference_link.link_timeout_ms} |",
        f"| a scan later than this stops the arm | {supervision.overrun_ms:g} |",
        f"SCHED_FIFO priority {CONFIG.fifo_priority}",
        f"{CONFIG.flight_recorder_scans} scans ({CONFIG.flight_recorder_scans * CONFIG.cycle_ms * 1e-3:g} s)",
        f"dead zone of {servo.dead_zone_mrad:g} mrad",
        f"σ_onset = {servo.damping_onset:g}",
        f"inside {CONFIG.settled.tolerance_mrad:g} mrad for {CONFIG.settled.time_ms * 1e-3:g} s",
        f"1 to {MAX_WAYPOINTS} waypoints",
        f"segment at {SAMPLES} instants",
        f"more than {CONFIG.motion.first_point_distance_m:g} m away",
        f"{stream.distance_m:g} m or {stream.turn_deg:g}° from the commanded pose",
        f"age ({stream.max_age_ms:g} ms at most)",
    ):
        assert text in flat, text


def test_the_numbers_of_the_page_on_parking_are_the_configuration_s() -> None:
    parking = CONFIG.parking
    flat = " ".join(PARKING_PAGE.split())
    for text in (
        f"The joint law has {parking.patience_ms * 1e-3:g} s to arrive",
        f"band ({parking.band_mm:g} mm of the tool",
        f"to {parking.band_most_mrad:g} mrad, once parked from {parking.band_least_mrad:g} on",
        f"`calm_mm` ({parking.calm_mm:g}) for `calm_ms` ({parking.calm_ms * 1e-3:g} s)",
        f"`stays_ms` ({parking.stays_ms * 1e-3:g} s)",
        f"half its band ({parking.band_least_mrad:g} mrad at least)",
    ):
        assert text in flat, text
