"""The controller's process: the cycle, its two links, its log, and what it leaves behind."""

import asyncio
import contextlib
import json
import os
import secrets
import signal
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from controller.config import ControllerConfig
from controller.core.flight_recorder import FlightRecorder
from controller.core.plant_watch import PlantRefusal
from controller.core.requests import is_live
from controller.core.scan import scan
from controller.core.scan_types import (
    RuntimeStatistics,
    ScanInput,
    ScanOutput,
    ScanState,
    initial_state,
    to_state,
)
from controller.core.settings import settings_from
from controller.shell.cyclic_task import CyclicTask, real_time_scheduling
from controller.shell.event_log import EventLog
from controller.shell.figures import resident_mb, write_figures
from controller.shell.flight_dump import checked_directory, dump
from controller.shell.histogram import Histogram
from controller.shell.plant_link import PlantLink
from controller.shell.reference_port import ReferencePort
from controller.shell.warm_up import warm_up
from foundation.configuration import configuration_hash
from foundation.link_key import read_key
from nominal_arm.description import NominalArm
from protocol.errors import ImageRefused
from protocol.faults import CommandCode, FaultCode
from protocol.process_image import SensorImage, ValveImage, decode_sensors, encode_valves
from protocol.reference_messages import Command
from protocol.server_session import ReferenceServer

_STATISTICS_PERIOD_NS = 10_000_000_000
_FIGURES_PERIOD_NS = 1_000_000_000  # the window of the percentiles in the state message
_SHUTDOWN_S = 1.4  # to ramp down after SIGTERM; the process must be gone within 2 s
_AFTER_FAULT_NS = 300_000_000  # the flight recorder also keeps what followed
_NS_PER_MS = 1_000_000


class Options(NamedTuple):
    """What the command line adds to the configuration."""

    record_dir: Path | None
    statistics: Path | None


class ControllerService:
    """One running controller."""

    def __init__(self, arm: NominalArm, config: ControllerConfig, options: Options, log: EventLog) -> None:
        """Bind the reference port. Raises ConfigurationError when that or the record directory fails."""
        self._config = config
        self._options = options
        self._log = log
        self._record_dir = None if options.record_dir is None else checked_directory(options.record_dir)
        self._settings = settings_from(arm, config)
        self._state = initial_state(self._settings)
        self._boot_id = secrets.randbits(64) or 1
        cycle_ns = round(config.cycle_ms * _NS_PER_MS)
        server = ReferenceServer(
            boot_id=self._boot_id,
            arm_hash=configuration_hash(arm),
            cycle_ns=cycle_ns,
            link_timeout_ms=config.reference_link.link_timeout_ms,
            key=read_key(config.reference_link.link_key),
        )
        self._reference = ReferencePort(server, config.reference_link, log)
        self._plant = PlantLink(config.plant_link, log)
        self._task = CyclicTask(cycle_ns, self._cycle)
        self._recorder = FlightRecorder(config.flight_recorder_scans)
        self._valve_words = encode_valves(ValveImage(0, 0, (0.0,) * 6))
        self._images_refused = 0
        self._scan_times = Histogram()
        self._memory_mb = 0.0
        self._scheduling = "normal"
        self._late_p50_us, self._late_p99_us = 0, 0
        self._figures_due_ns = 0
        self._statistics_due_ns = 0
        self._stop_by_ns: int | None = None
        self._told_to_leave = False
        self._dump_due_ns: int | None = None
        self._dumps: list[asyncio.Task[None]] = []

    async def run(self) -> None:
        """Serve until SIGTERM or SIGINT, then ramp down, centre the valves and say goodbye."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self._asked_to_stop)
        warm_up(self._settings)
        self._reference.open()
        self._plant.start()
        self._scheduling = real_time_scheduling(self._config.fifo_priority)
        self._statistics_due_ns = time.monotonic_ns() + _STATISTICS_PERIOD_NS
        self._memory_mb = resident_mb()
        self._say_ready()
        try:
            await self._task.run()
        finally:
            await self._shut_down()

    async def _cycle(self, dt_ns: int) -> None:
        words = await self._plant.exchange(self._valve_words)
        sensors = self._decoded(words)
        now_ns = time.monotonic_ns()
        requests, alive = self._reference.take(now_ns)
        leaving = self._stop_by_ns is not None and not self._told_to_leave
        if leaving:
            self._told_to_leave = True
            requests = (*requests, Command(0, CommandCode.DISABLE))
        inputs = ScanInput(now_ns, dt_ns * 1e-9, sensors, requests, alive, self._reference.take_streamed())
        began_ns = time.monotonic_ns()
        self._state, output = scan(self._settings, self._state, inputs)
        self._scan_times.add(time.monotonic_ns() - began_ns)
        self._valve_words = encode_valves(output.valves)
        answers = output.acknowledgements[:-1] if leaving else output.acknowledgements
        shown = to_state(output.view, self._statistics_at(now_ns))
        self._reference.publish(answers, shown, now_ns, output.refusal)
        self._recorder.record(inputs, output)
        self._follow_up(self._state, output, now_ns)

    def _decoded(self, words: list[int] | PlantRefusal | None) -> SensorImage | PlantRefusal | None:
        if not isinstance(words, list):
            return words
        try:
            return decode_sensors(words)
        except ImageRefused as refusal:
            self._images_refused += 1
            if self._images_refused.bit_count() == 1:
                self._log.write("image_refused", "warning", cause=refusal.cause, detail=str(refusal))
            return None

    def _statistics_at(self, now_ns: int) -> RuntimeStatistics:
        """Figures for the state message; the percentiles are those of the last second."""
        if now_ns >= self._figures_due_ns:
            self._figures_due_ns = now_ns + _FIGURES_PERIOD_NS
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

    def _follow_up(self, state: ScanState, output: ScanOutput, now_ns: int) -> None:
        """Log what happened, dump the flight recorder when its time has come, end when asked to."""
        for event in output.events:
            level = "error" if event.name == "fault" else "info"
            self._log.write(event.name, level, cause=event.cause, value=event.value, limit=event.limit)
            if event.name == "fault" and self._record_dir is not None and self._dump_due_ns is None:
                self._dump_due_ns = now_ns + _AFTER_FAULT_NS
        if self._dump_due_ns is not None and now_ns >= self._dump_due_ns and not is_live(state):
            self._dump_due_ns = None
            self._dump(state.fault.code)
        if now_ns >= self._statistics_due_ns:
            self._statistics_due_ns = now_ns + _STATISTICS_PERIOD_NS
            self._write_statistics()
        if self._stop_by_ns is not None and (not is_live(state) or now_ns >= self._stop_by_ns):
            self._task.stop()

    def _dump(self, fault: FaultCode) -> None:
        assert self._record_dir is not None
        number = len(self._dumps) + 1
        job = dump(self._record_dir, fault.name, number, self._recorder.entries(), self._log)
        self._dumps.append(asyncio.ensure_future(job))

    def _asked_to_stop(self) -> None:
        if self._stop_by_ns is None:
            self._stop_by_ns = time.monotonic_ns() + round(_SHUTDOWN_S * 1e9)

    async def _shut_down(self) -> None:
        cycle = self._state.cycle + 1
        self._valve_words = encode_valves(ValveImage(cycle, 0, (0.0,) * 6))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.1):
                await self._plant.exchange(self._valve_words)
        await self._plant.close()
        self._reference.close()
        await asyncio.gather(*self._dumps)
        self._write_statistics()
        self._log.write("stopped", cycles=self._task.lateness.count, overruns=self._task.overruns)

    def _say_ready(self) -> None:
        host, port = self._reference.address
        ready = {
            "event": "ready",
            "service": "controller",
            "pid": os.getpid(),
            "reference_link": {"host": host, "port": port},
            "plant_link": {"host": self._config.plant_link.host, "port": self._config.plant_link.port},
            "cycle_ms": self._config.cycle_ms,
            "scheduling": self._scheduling,
            "boot_id": self._boot_id,
        }
        print(json.dumps(ready), flush=True)

    def _write_statistics(self) -> None:
        if self._options.statistics is None:
            return
        served, missed = self._task.lateness.count, self._task.overruns
        figures: dict[str, Any] = {
            "service": "controller",
            "cycle_ms": self._config.cycle_ms,
            "scheduling": self._scheduling,
            "cycles": served,
            "overruns": missed,
            "overruns_percent": 100.0 * missed / (served + missed) if served else 0.0,
            **self._task.lateness.as_dict("late"),
            **self._plant.round_trip.as_dict("round_trip"),
            **self._scan_times.as_dict("scan"),
            "plant_exchanges": self._plant.round_trip.count,
            "plant_exchange_failures": dict(self._plant.failures),
            "plant_connections": self._plant.connections,
            "images_refused": self._images_refused,
            "reference_link": asdict(self._reference.server.statistics)
            | {"flooded": self._reference.flooded},
            "log_lines_dropped": self._log.dropped,
            "rss_mb_at_start": self._memory_mb,
            "rss_mb": resident_mb(),
        }
        write_figures(self._options.statistics, figures, self._log)
