"""The flight record, made into text beside the scan."""

from pathlib import Path

from controller.core.flight_recorder import Scan
from controller.core.scan_types import ScanInput
from controller.core.settings import ScanSettings
from controller.shell.service import dump
from foundation.event_log import EventLog
from tests.controller.obedient_plant import Bench


def _flown(settings: ScanSettings) -> Scan:
    """A scan of a motion."""
    bench = Bench(settings).moving()
    return ScanInput(bench.now_ns, bench.now_ns, settings.cycle_s, None, (), True), bench.step()


async def test_a_record_that_cannot_be_written_is_told(settings: ScanSettings, tmp_path: Path) -> None:
    log = EventLog("controller")
    told: list[str] = []
    log.listener = lambda event, _level, fields: told.append(f"{event} {fields['cause']}")
    await dump(tmp_path / "nowhere", "PLANT_STATUS", 1, [_flown(settings)], log)
    assert told == ["flight_record_failed recording.unwritable"]
