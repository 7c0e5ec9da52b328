"""The controller's process: the cycle, its two links, its log, and what it leaves behind."""

import asyncio
import contextlib
import json
import secrets
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from controller.commissioning import basis_of
from controller.config import ControllerConfig
from controller.core.flight_recorder import Scan, plain
from controller.core.plant_watch import PlantRefusal
from controller.core.requests import is_live
from controller.core.scan_program import Parts, own_parts
from controller.core.scan_types import (
    RuntimeStatistics,
    ScanInput,
    ScanOutput,
    ScanState,
    to_state,
)
from controller.shell.controller_metrics import METRICS
from controller.shell.cyclic_task import CyclicTask, warm_up
from controller.shell.plant_link import PlantLink
from controller.shell.reference_port import ReferencePort
from controller.shell.scan_recorder import ScanRecorder, TrialRecords
from foundation import clock
from foundation.event_log import EventLog, Level
from foundation.live.feed import LiveFeed, open_show
from foundation.live.wire import Spread, exposition
from foundation.periods import DurationHistogram, percent_missed, take_fifo
from foundation.recording.beginning import recording_directory
from foundation.secret_source import read_key
from foundation.self_watch import DiskWatch, resident_mb
from foundation.service_main import ServiceOptions, on_termination, say_ready
from nominal_arm.description import NominalArm
from protocol.errors import ConfigurationError, ImageRefused
from protocol.faults import CommandCode, FaultCode
from protocol.process_image import SensorImage, ValveImage, decode_sensors, encode_valves
from protocol.reference_messages import Command, Request


async def dump(directory: Path, fault: str, number: int, scans: Sequence[Scan], log: EventLog) -> None:
    """Write ``scans`` as JSON lines, oldest first, to ``flight_<number>_<fault>.jsonl``; a full disk is
    logged."""
    path = directory / f"flight_{number:03d}_{fault.lower()}.jsonl"
    try:
        await asyncio.to_thread(_write, path, scans)
    except OSError as error:
        log.write(
            "flight_record_failed", "error", cause="recording.unwritable", detail=f"{path}: {error.strerror}"
        )
    else:
        log.write("flight_record", path=str(path), scans=len(scans), fault=fault)


def _write(path: Path, scans: Sequence[Scan]) -> None:
    with path.open("w", encoding="utf-8") as file:
        for each in scans:  # one at a time: the scan gets the interpreter in between, and memory stays small
            file.write(json.dumps(plain(each)) + "\n")


_STATE_STATISTICS_NS = 1_000_000_000  # the window of the percentiles in the state message
_SHUTDOWN_S = 1.4  # to ramp down after SIGTERM; the process must be gone within 2 s
_AFTER_FAULT_NS = 300_000_000  # the flight recorder also keeps what followed
_NS_PER_MS = 1_000_000
_LEVELS: dict[str, Level] = {"fault": "error", "unsettled": "warning"}


class ControllerService:
    """One running controller."""

    def __init__(
        self,
        arm: NominalArm,
        config: ControllerConfig,
        options: ServiceOptions,
        log: EventLog,
        parts: Parts = own_parts,
    ) -> None:
        """Bind the reference port, then try the directories; ``parts`` make scan and sessions.

        Raises ConfigurationError.
        """
        self._config = config
        self._log = log
        self._boot_id = secrets.randbits(64) or 1
        cycle_ns = round(config.cycle_ms * _NS_PER_MS)
        drawn, key = self._boot_id | secrets.randbits(128) << 64, read_key(config.reference_link.link_key)
        self._program, server = parts(arm, config, drawn, key)
        self._reference = ReferencePort(server, config.reference_link, log)
        try:
            self._record_dir = recording_directory(options.record_dir)
            self._trials = TrialRecords(self._record_dir, self._program, basis_of(arm, config), log)
            self._show, self._scans = self._open_records(arm)
        except ConfigurationError:
            self._reference.release()
            raise
        self._plant = PlantLink(config.plant_link, log)
        self._task = CyclicTask(cycle_ns, self._cycle, round((1.0 - config.scan_lead) * cycle_ns))
        self._flown: deque[Scan] = deque(maxlen=config.flight_recorder_scans)
        self._valve_words = encode_valves(ValveImage(0, 0, (0.0,) * 6))
        self._images_refused = 0
        self._scan_times = DurationHistogram()
        self._scheduling = "normal"
        self._late_p50_us, self._late_p99_us = 0, 0
        self._percentiles_due_ns = 0
        self._stop_by_ns: int | None = None
        self._leave_requested = False
        self._dump_due_ns: int | None = None
        self._dumps: list[asyncio.Task[None]] = []

    async def run(self) -> int:
        """Serve until SIGTERM or SIGINT, then ramp down, centre the valves and say goodbye."""
        on_termination(self._stop_requested)
        following = clock.followed()
        warm_up(self._program.settings)
        if following is not None:
            await following.join(round(self._config.cycle_ms * _NS_PER_MS))
        self._reference.open()
        self._plant.start()
        if following is not None:
            following.in_vain = self._plant.give_up
            await self._plant.connected()
        self._scheduling = take_fifo(self._config.fifo_priority)
        self._say_ready()
        watch = DiskWatch(self._log, self._record_dir)
        beside = asyncio.create_task(watch.keep_looking())
        if following is not None:
            following.ready()
        try:
            await self._task.run()
        finally:
            beside.cancel()
            await self._shut_down()
        return 0

    async def _cycle(self, dt_ns: int) -> None:
        words = await self._plant.exchange(self._valve_words)
        sensors, sensed_ns = self._decode_sensors(words), clock.now_ns()
        await self._task.second_part()  # what comes meanwhile is in this scan too
        now_ns = clock.now_ns()
        requests, alive = self._reference.take(now_ns)
        leaving = self._stop_by_ns is not None and not self._leave_requested
        if leaving:
            self._leave_requested = True
            requests = (*requests, Command(0, CommandCode.DISABLE))
        streamed = self._reference.take_streamed()
        inputs = ScanInput(now_ns, sensed_ns, dt_ns * 1e-9, sensors, requests, alive, streamed)
        began_ns = time.monotonic_ns()
        output = self._program.scan(inputs)
        self._scan_times.add(time.monotonic_ns() - began_ns)
        self._valve_words = encode_valves(output.valves)
        answers = output.acknowledgements[:-1] if leaving else output.acknowledgements
        shown = to_state(output.view, self._statistics_at(now_ns))
        self._reference.publish(answers, shown, now_ns, output.refusal)
        self._flown.append((inputs, output))
        if self._scans is not None:
            self._scans.scan(inputs, output)
        self._trials.follow()
        self._follow_up(self._program.state, requests, output, now_ns)

    def _decode_sensors(self, words: list[int] | PlantRefusal | None) -> SensorImage | PlantRefusal | None:
        if not isinstance(words, list):
            return words
        try:
            return decode_sensors(words)
        except ImageRefused as refusal:
            self._images_refused += 1
            self._log.write_repeated(
                refusal.cause, "image_refused", "warning", cause=refusal.cause, detail=str(refusal)
            )
            return None

    def _statistics_at(self, now_ns: int) -> RuntimeStatistics:
        """The statistics in the state message; the percentiles are those of the last second."""
        if now_ns >= self._percentiles_due_ns:
            self._percentiles_due_ns = now_ns + _STATE_STATISTICS_NS
            self._late_p50_us, self._late_p99_us = self._task.recent.percentiles_us(0.5, 0.99)
            self._task.recent.clear()
        link = self._reference.server.statistics
        return RuntimeStatistics(
            overruns=self._task.overruns,
            lateness_p50_us=self._late_p50_us,
            lateness_p99_us=self._late_p99_us,
            lateness_max_us=self._task.lateness.max_ns // 1000,
            references_lost=link.lost,
            references_dropped=link.dropped,
        )

    def _follow_up(
        self, state: ScanState, requests: tuple[Request, ...], output: ScanOutput, now_ns: int
    ) -> None:
        """Log what happened, dump the flight recorder when its time has come, end when asked to."""
        for event in output.events:
            level: Level = _LEVELS.get(event.name, "info")
            name, *number = event.name.split()  # the answer to "Command 7" is event "command" of request 7
            fields: dict[str, Any] = {"cause": event.cause, "value": event.value, "limit": event.limit}
            if number:
                fields["request"] = int(number[0])
            code = next((_code(each) for each in requests if number == [str(each.command_id)]), None)
            if code is not None:
                fields["command"] = code
            self._log.write_repeated((event.cause, code), name.lower(), level, **fields)
            if event.name == "fault" and self._record_dir is not None and self._dump_due_ns is None:
                self._dump_due_ns = now_ns + _AFTER_FAULT_NS
        if self._dump_due_ns is not None and now_ns >= self._dump_due_ns and not is_live(state):
            self._dump_due_ns = None
            self._dump(state.fault.code)
        if self._stop_by_ns is not None and (not is_live(state) or now_ns >= self._stop_by_ns):
            self._task.stop()

    def _dump(self, fault: FaultCode) -> None:
        assert self._record_dir is not None
        number = len(self._dumps) + 1
        job = dump(self._record_dir, fault.name, number, tuple(self._flown), self._log)
        self._dumps.append(asyncio.ensure_future(job))

    def _stop_requested(self) -> None:
        if self._stop_by_ns is None:
            self._stop_by_ns = clock.now_ns() + round(_SHUTDOWN_S * 1e9)
            # Also where the plant's time stands.
            asyncio.get_running_loop().call_later(_SHUTDOWN_S, self._stop)

    def _stop(self) -> None:
        clock.current().leave()
        self._task.stop()

    async def _shut_down(self) -> None:
        cycle = self._program.state.cycle + 1
        self._valve_words = encode_valves(ValveImage(cycle, 0, (0.0,) * 6))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.1):
                await self._plant.exchange(self._valve_words)
        await self._plant.close()
        self._reference.close()
        await asyncio.gather(*self._dumps)
        await self._trials.close()
        if self._scans is not None:
            await asyncio.to_thread(self._scans.close)
        if self._show is not None:
            await asyncio.to_thread(self._show.close)
        self._log.write("stopped", statistics=self._gathered())

    def _open_records(self, arm: NominalArm) -> tuple[LiveFeed | None, ScanRecorder | None]:
        """What is shown and what is recorded. Raises ConfigurationError."""
        config, recorded = self._config, self._record_dir is not None
        fifo = config.fifo_priority
        show = open_show("controller", self._log, self._metrics_text, fifo)
        if config.recording_hz == 0.0 or (show is None and not recorded):
            if show is not None:
                show.opened(False)(Path(), (), {})  # figures alone
            return show, None
        made = None if show is None else show.opened(recorded, fifo)
        scans = ScanRecorder(self._record_dir or Path(), arm, config, made=made)
        scans.tell_failure(self._log.write)
        return show, scans

    def _say_ready(self) -> None:
        host, port = self._reference.address
        say_ready(
            "controller",
            reference_link={"host": host, "port": port},
            plant_link={"host": self._config.plant_link.host, "port": self._config.plant_link.port},
            cycle_ms=self._config.cycle_ms,
            scheduling=self._scheduling,
            boot_id=self._boot_id,
        )

    def _metrics_text(self) -> str:
        """Its text for Prometheus; asked for by the thread that feeds the live face."""
        spreads = (
            Spread("scan_lateness_seconds", "How late scans began.", self._task.lateness),
            Spread("scan_duration_seconds", "How long scans computed.", self._scan_times),
            Spread("plant_round_trip_seconds", "Exchanges with the plant.", self._plant.round_trip),
        )
        values = self._gathered() | {"log_lines_dropped": self._log.dropped}
        return exposition("controller", METRICS, values, spreads)

    def _gathered(self) -> dict[str, Any]:
        served, missed = self._task.lateness.count, self._task.overruns
        return {
            "cycle_ms": self._config.cycle_ms,
            "scheduling": self._scheduling,
            "cycles": served,
            "overruns": missed,
            "overruns_percent": percent_missed(served, missed),
            **self._task.lateness.as_dict("late"),
            **self._plant.round_trip.as_dict("round_trip"),
            **self._scan_times.as_dict("scan"),
            "plant_exchanges": self._plant.round_trip.count,
            "plant_exchange_failures": dict(self._plant.failures),
            "plant_connections": self._plant.connections,
            "images_refused": self._images_refused,
            "scan_records": 0 if self._scans is None else self._scans.sink.written,
            "scan_records_dropped": 0 if self._scans is None else self._scans.sink.dropped,
            "reference_link": asdict(self._reference.server.statistics)
            | {"flooded": self._reference.flooded},
            "live_dropped": 0 if self._show is None else self._show.dropped,
            "rss_mb": resident_mb(),
        }


def _code(request: Request) -> str | None:
    """What a command asks for; None of a reference."""
    if not isinstance(request, Command):
        return None
    return request.code.name if isinstance(request.code, CommandCode) else "UNKNOWN"
