"""The flight record: taken in the scan, made into text beside it."""

import json
from pathlib import Path

from controller.core.flight_recorder import FlightRecorder
from controller.core.scan_types import ScanInput
from controller.core.settings import ScanSettings
from controller.shell.service import dump
from foundation.event_log import EventLog
from tests.controller.obedient_plant import Bench


def _flown(settings: ScanSettings, scans: int, room: int) -> tuple[FlightRecorder, int]:
    """A recorder of ``room`` scans after ``scans`` scans of a motion, and the number of the last cycle."""
    bench, recorder = Bench(settings).moving(), FlightRecorder(room)
    for _ in range(scans):
        inputs = ScanInput(bench.now_ns, bench.now_ns, settings.cycle_s, None, (), True)
        recorder.record(inputs, bench.step())
    return recorder, bench.last.view.cycle


async def test_the_newest_scans_are_written_oldest_first(settings: ScanSettings, tmp_path: Path) -> None:
    recorder, newest = _flown(settings, scans=7, room=5)
    taken = recorder.kept()
    recorder.record(*taken[0])  # the ring goes on while the file is written
    await dump(tmp_path, "PLANT_STATUS", 3, taken, EventLog("controller"))
    lines = (tmp_path / "flight_003_plant_status.jsonl").read_text().splitlines()
    assert [json.loads(line)["view"]["cycle"] for line in lines] == list(range(newest - 4, newest + 1))


async def test_a_record_that_cannot_be_written_is_told(settings: ScanSettings, tmp_path: Path) -> None:
    recorder, _ = _flown(settings, scans=1, room=1)
    log = EventLog("controller")
    told: list[str] = []
    log.listener = lambda event, _level, fields: told.append(f"{event} {fields['cause']}")
    await dump(tmp_path / "nowhere", "PLANT_STATUS", 1, recorder.kept(), log)
    assert told == ["flight_record_failed recording.unwritable"]
