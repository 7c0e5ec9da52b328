"""Kills and suspensions of the controller within motions, three real processes.

The plant closes its valves by its own watchdog. Nothing moves again by itself, neither when a suspended
controller goes on nor when a new one starts. Judged by the plant's own recording of the true spools, on the
plant's clock, and by the status bits in its registers.
"""

import os
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyModbusTCP.client import ModbusClient

from foundation.configuration import merged, parse_overrides
from protocol.errors import LinkLost
from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from protocol.process_image import (
    INPUT_ADDRESS,
    INPUT_WORDS,
    STATUS_VALVES_ENABLED,
    STATUS_WATCHDOG_TRIPPED,
    decode_sensors,
)
from testbed.choices import ClockKind, Timing
from testbed.realtime.child import Service
from testbed.realtime.launch import CONTROLLER, PLANT, Launch, prepare
from testbed.realtime.supervisor import Supervisor, supervised
from testbed.recordings.plant_truth import Recording, read_truth
from tests.support.live_client import LiveClient

SHUT = 2e-3  # of spool: within the overlap, where no oil flows
CLOSING_MS = 30.0  # drive electronics and servo valve, from the centred word to the shut spool
KILL, SUSPEND_LONG = "kill", "suspend 5 s"
_STATUS_AFTER_S = 0.3  # the registers are asked: after the motion watchdog, before the coupler's of 1 s
_QUIET_S = 0.5  # how long nothing may happen once the controller is back
_TRUTH_HZ = 250.0


@dataclass(frozen=True)
class KillTrial:
    """One kill or suspension. Times are of the monotonic clock; ``fault``: what the controller then said."""

    kind: str
    signal_ns: int
    end_ns: int
    tripped: bool
    disabled: bool
    group: str
    fault: str


class KillRig:
    """A plant that stays up, and controllers that come and go."""

    def __init__(self, launch: Launch, supervisor: Supervisor) -> None:
        self._supervisor = supervisor
        services = {service.name: service for service in launch.services}
        self._controller: Service = services[CONTROLLER]
        modbus, link = launch.settings.plant_service.modbus, launch.settings.controller.reference_link
        self._onlooker = ModbusClient(modbus.host, modbus.port, 1, timeout=2.0)  # only reads
        self.client = LiveClient(link.host, link.port)

    def status(self) -> int:
        """The plant's status bits."""
        words = self._onlooker.read_input_registers(INPUT_ADDRESS, INPUT_WORDS)
        assert words is not None, self._onlooker.last_error_as_txt
        return decode_sensors(words).status

    @property
    def pid(self) -> int:
        """The controller's process number."""
        return self._supervisor.children[CONTROLLER].pid

    def kill(self) -> None:
        """SIGKILL, and the remains are cleared away."""
        self._supervisor.children[CONTROLLER].kill()

    def start(self) -> None:
        """A controller that is ready."""
        self._supervisor.start(self._controller, say=str)

    def moving(self, rng: np.random.Generator) -> None:
        """The arm in the middle of a random motion."""
        client = self.client
        state = client.state if client.connected and client.state is not None else client.connect()
        if state.group_state is GroupState.ERROR_STOP:
            client.until(lambda s: s.group_state is GroupState.ERROR_STOP, 5.0)
            insist(client, CommandCode.RESET)
        insist(client, CommandCode.ENABLE)
        state = client.until(lambda s: s.group_state is GroupState.STANDBY, 5.0)
        y, z = state.X_BT.p_m[1], state.X_BT.p_m[2]
        aim = (rng.uniform(0.15, 0.3) * (-1.0 if y > 0.0 else 1.0), rng.uniform(0.9, 1.3) - z)
        answer = client.move_by((0.0, *aim))
        if answer.reason is not Reason.ACCEPTED:
            raise LinkLost("link.refused", f"a motion by {aim} m was refused: {answer}")
        client.until(lambda s: max(map(abs, s.valves)) > 0.01, 2.0)
        client.pump(rng.uniform(0.0, 1.0))

    def close(self) -> None:
        """Hang up."""
        self._onlooker.close()
        self.client.__exit__(None, None, None)


def insist(client: LiveClient, code: CommandCode) -> None:
    """Repeat the command until it is accepted, for at most the time that arming a watchdog takes."""
    deadline_s = time.monotonic() + 3.0
    while (reason := client.command(code)) not in (Reason.ACCEPTED, Reason.ALREADY_DONE, Reason.NOT_IN_ERROR):
        if time.monotonic() > deadline_s:
            raise LinkLost("link.refused", f"{code.name} is refused: {reason.name}")
        client.pump(0.05)


def one_trial(rig: KillRig, kind: str, rng: np.random.Generator) -> KillTrial:
    """A kill or a suspension within a motion, and what the registers said before the controller was back."""
    rig.moving(rng)
    signal_ns = time.monotonic_ns()
    if kind == KILL:
        rig.kill()
    else:
        os.kill(rig.pid, signal.SIGSTOP)
    rig.client.pump(_STATUS_AFTER_S)  # vision is there all the while, and may see no loss
    status = rig.status()
    if kind == KILL:
        rig.start()
    else:
        rig.client.pump(5.0)
        os.kill(rig.pid, signal.SIGCONT)
    rig.client.pump(_QUIET_S)
    if not rig.client.connected or kind == KILL:
        rig.client.connect()
    state = rig.client.until(lambda s: True, 2.0)
    return KillTrial(
        kind=kind,
        signal_ns=signal_ns,
        end_ns=time.monotonic_ns(),
        tripped=bool(status & STATUS_WATCHDOG_TRIPPED),
        disabled=not status & STATUS_VALVES_ENABLED,
        group=GroupState(state.group_state).name,
        fault=FaultCode(state.fault).name,
    )


class Judge:
    """The plant's recording, asked about one trial after the other."""

    def __init__(self, recording: Recording) -> None:
        self._log_ns = recording.log_ns()
        self._plant_ns: NDArray[np.float64] = recording.stacked("time_ns")
        self._opening = np.abs(recording.stacked("spools")).max(axis=1)

    def row(self, trial: KillTrial, limit_ms: float) -> dict[str, Any]:
        """The trial with its figures: ms on the plant's clock from the signal to the shut spool, and after.

        ``resumed``: whether any spool opened again before somebody asked for it.
        """
        begin, end = np.searchsorted(self._log_ns, [trial.signal_ns, trial.end_ns])
        opening, at_ms = self._opening[begin:end], 1e-6 * (self._plant_ns[begin:end] - self._plant_ns[begin])
        shut_ms = float(at_ms[np.flatnonzero(opening > SHUT)[-1]]) if (opening > SHUT).any() else 0.0
        resumed = bool((opening[at_ms > limit_ms] > SHUT).any())
        row = asdict(trial) | {
            "opening_at_signal": float(self._opening[max(begin - 1, 0)]),
            "shut_ms": shut_ms,
            "resumed": resumed or trial.group in ("STANDBY", "MOVING", "STOPPING"),
        }
        row["pass"] = shut_ms <= limit_ms and not row["resumed"] and trial.tripped and trial.disabled
        return row


@contextmanager
def trial_rig(config_dir: Path, assignments: list[str], directory: Path) -> Iterator[tuple[Launch, KillRig]]:
    """Plant and controller running, without anybody at the camera, and a client that is not yet connected."""
    overrides = merged(
        {
            "plant_service": {"truth_hz": _TRUTH_HZ},
            "scene": {"camera": {"rate_hz": 1.0}},  # nobody looks
        },
        parse_overrides(assignments),
    )
    wall = Timing(ClockKind.WALL)  # the client is foreign
    launch = prepare(config_dir, overrides, directory, any_ports=True, timing=wall)
    services = [service for service in launch.services if service.name in (PLANT, CONTROLLER)]
    with supervised(services, directory) as supervisor:
        rig = KillRig(launch, supervisor)
        try:
            yield launch, rig
        finally:
            rig.close()


def run_trials(
    config_dir: Path, assignments: list[str], kinds: Sequence[str], seed: int, directory: Path
) -> list[dict[str, Any]]:
    """One row a trial; ``limit_ms`` is what it was judged by."""
    rng = np.random.default_rng(seed)
    with trial_rig(config_dir, assignments, directory) as (launch, rig):
        trials = [one_trial(rig, kind, rng) for kind in kinds]
        limit_ms = launch.settings.plant.watchdog_ms + CLOSING_MS
    judge = Judge(read_truth(launch.records(PLANT) / "truth.mcap"))
    return [judge.row(trial, limit_ms) | {"limit_ms": limit_ms} for trial in trials]
