"""The plant's end of the fault API: starts its process, takes one order a step, tells it of every change."""

import asyncio
import contextlib
import socket
from collections.abc import Callable

from foundation.child_process import ended, started
from foundation.event_log import EventLog
from foundation.rest.tokens import configured_access
from plant_emulator.config.service import FaultApiConfig
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.fault_execution import carry_out, fault_state, true_points
from plant_emulator.core.faults.schedule import (
    MOST_BYTES,
    Injection,
    OrderMessage,
    PlantMessage,
    RestartOrder,
)
from plant_emulator.core.plant import Plant
from protocol.errors import LinkLost

_TOLD_EVERY_NS = 50_000_000


class FaultDesk:
    """Between two steps of the plant at most one order is carried out, whatever the API is asked."""

    def __init__(
        self,
        plant: Plant,
        scene: Scene,
        config: FaultApiConfig,
        log: EventLog,
        restart: Callable[[], object] = lambda: None,
    ) -> None:
        """``restart`` is called once the API has its answer to such an order.

        Raises ConfigurationError as ``configured_access`` does.
        """
        configured_access(config, "plant_service.fault_face")  # judged here, where a refusal ends the start
        self._plant = plant
        self._scene = scene
        self._config = config
        self._log = log
        self._restart = restart
        self._link, self._theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._link.setblocking(False)
        self._told: tuple[tuple[Injection, ...], tuple[Injection, ...]] | None = None
        self._told_ns = 0

    def start(self, listener: socket.socket, scheduling: str) -> None:
        """Start the process, which serves at ``listener``."""
        listener.listen()
        with listener, self._theirs as theirs:
            inherited, given = (listener.fileno(), theirs.fileno()), self._config.model_dump_json().encode()
            self._process = started("plant_emulator.shell.fault_api", given, inherited, scheduling)

    @property
    def pid(self) -> int:
        """Process number of the API."""
        return self._process.pid

    async def wait_ready(self) -> None:
        """Return when it serves. Raises LinkLost when it ended instead."""
        if not await asyncio.get_running_loop().sock_recv(self._link, MOST_BYTES):
            raise LinkLost("link.fault_api_ended", f"the fault API ended with status {self._process.wait()}")

    def close(self) -> None:
        """Close the connection to the process."""
        self._link.close()
        self._theirs.close()

    def step(self) -> None:
        """Carry out an order if one waits, and tell the state when it has changed or 50 ms have passed."""
        if self._link.fileno() < 0:
            return
        faults = self._plant.faults
        try:
            data = self._link.recv(MOST_BYTES)
        except BlockingIOError:
            now = (faults.active, faults.planned)
            if now != self._told or self._plant.time_ns - self._told_ns >= _TOLD_EVERY_NS:
                self._tell(PlantMessage(state=fault_state(self._plant)))
            return
        except OSError:
            data = b""
        if data:
            message = OrderMessage.model_validate_json(data)
            self._tell(carry_out(message, self._plant, self._scene.cover))
            if isinstance(message.order, RestartOrder):
                self._log.write("restart_asked")
                self._restart()
        else:
            self._link.close()
            self._log.write(
                "fault_api_ended",
                "error",
                cause="link.fault_api_ended",
                detail="by itself; the plant goes on",
            )

    async def stop(self) -> None:
        """End the process."""
        self.close()
        if hasattr(self, "_process"):
            await asyncio.to_thread(ended, self._process)

    def _tell(self, message: PlantMessage) -> None:
        self._told = (self._plant.faults.active, self._plant.faults.planned)
        self._told_ns = self._plant.time_ns
        if self._config.shows_truth:
            message = message.model_copy(update={"arm_points_m": true_points(self._plant)})
        with contextlib.suppress(OSError):  # an API that does not take it is not waited for
            self._link.send(message.model_dump_json().encode())
