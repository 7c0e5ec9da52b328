"""The plant's end of the fault API: starts its process, and carries out one order after the other."""

import asyncio
import contextlib
import socket
from collections.abc import Callable

from foundation.child_process import ended, started
from foundation.event_log import EventLog
from foundation.rest.tokens import configured_access
from plant_emulator.config.service import FaultApiConfig
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.fault_execution import carry_out
from plant_emulator.core.faults.schedule import MOST_BYTES, OrderMessage, RestartOrder
from plant_emulator.core.plant import Plant
from protocol.errors import LinkLost


class FaultDesk:
    """The API sends its next order when it has the answer to the last one."""

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

    def start(self, listener: socket.socket) -> None:
        """Start the process, which serves at ``listener``."""
        listener.listen()
        with listener, self._theirs as theirs:
            inherited, given = (listener.fileno(), theirs.fileno()), self._config.model_dump_json().encode()
            self._process = started("plant_emulator.shell.fault_api", given, inherited)

    @property
    def pid(self) -> int:
        """Process number of the API."""
        return self._process.pid

    async def wait_ready(self) -> None:
        """Return when it serves; from then on orders are carried out. Raises LinkLost if it ended instead."""
        loop = asyncio.get_running_loop()
        if not await loop.sock_recv(self._link, MOST_BYTES):
            raise LinkLost("link.fault_api_ended", f"the fault API ended with status {self._process.wait()}")
        loop.add_reader(self._link, self.serve)

    def close(self) -> None:
        """Close the connection to the process."""
        if self._link.fileno() >= 0:
            asyncio.get_running_loop().remove_reader(self._link)
        self._link.close()
        self._theirs.close()

    def serve(self) -> None:
        """Carry out the order that has come, between two steps of the plant."""
        try:
            data = self._link.recv(MOST_BYTES)
        except OSError:
            data = b""
        if not data:
            self.close()
            why = {"cause": "link.fault_api_ended", "detail": "by itself; the plant goes on"}
            self._log.write("fault_api_ended", "error", **why)
            return
        message = OrderMessage.model_validate_json(data)
        truth = self._config.shows_truth
        answer = carry_out(message, self._plant, self._scene.cover, shows_truth=truth)
        with contextlib.suppress(OSError):  # an API that does not take it is not waited for
            self._link.send(answer.model_dump_json().encode())
        if isinstance(message.order, RestartOrder):
            self._log.write("restart_asked")
            self._restart()

    async def stop(self) -> None:
        """End the process."""
        self.close()
        if hasattr(self, "_process"):
            await asyncio.to_thread(ended, self._process)
