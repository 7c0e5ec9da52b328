"""The example controller in C: as a library under the simulated clock and network, or as a program."""

import ctypes
import json
import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

from tests.conformance.simulated_network import SimulatedNetwork, SimulatedSocket
from tests.support.paths import ROOT

SOURCE = ROOT / "examples" / "controller_c" / "controller.c"
COMPILER = shutil.which("cc")
WARNINGS = ("-std=c11", "-O2", "-Wall", "-Wextra", "-Werror")
CYCLE_NS = 5_000_000


class _Address(ctypes.Structure):
    """struct sockaddr_in."""

    _fields_ = (
        ("family", ctypes.c_uint16),
        ("port", ctypes.c_uint16),
        ("host", ctypes.c_uint32),
        ("zero", ctypes.c_uint8 * 8),
    )


_CLOCK = ctypes.CFUNCTYPE(ctypes.c_uint64)
_TRANSMIT = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_size_t, ctypes.POINTER(_Address))


def compiled(directory: Path, *flags: str, source: str | None = None) -> Path:
    """The compiled controller, or what ``source`` makes of it; with ``-shared`` as a library."""
    assert COMPILER is not None
    code = directory / "controller.c"
    code.write_text(SOURCE.read_text() if source is None else source)
    made = directory / "controller"
    subprocess.run([COMPILER, *WARNINGS, *flags, "-o", made, code, "-lm"], check=True, timeout=120)
    return made


class SimulatedCController:
    """The library on the simulated network; its scans come every cycle of simulated time.

    It takes datagrams on arrival, or where ``in_scan`` when a scan is due, as the task of a PLC does.
    """

    def __init__(
        self, library: Path, network: SimulatedNetwork, cycle_ns: int = CYCLE_NS, *, in_scan: bool = False
    ) -> None:
        self._library: Any = ctypes.CDLL(str(library))
        self._network, self._cycle_ns, self._in_scan = network, cycle_ns, in_scan
        self._socket = SimulatedSocket(network)
        self.port = self._socket.address[1]
        self.next_ns = network.now_ns
        # Kept: the library holds but their addresses.
        self._callbacks = (_CLOCK(network.clock_ns), _TRANSMIT(self._transmit))
        for name, callback in zip(("now_ns", "transmit"), self._callbacks, strict=True):
            place = ctypes.c_void_p.in_dll(self._library, name)
            place.value = ctypes.cast(callback, ctypes.c_void_p).value

    def _transmit(self, data: int, size: int, to: Any) -> None:
        address = to.contents
        self._socket.sendto(ctypes.string_at(data, size), ("127.0.0.1", socket.ntohs(address.port)))

    def turn(self) -> None:
        """Read, scan if a scan is due, and send."""
        due = self._network.clock_ns() >= self.next_ns
        while (due or not self._in_scan) and self._socket.inbox and self._socket.readable():
            data, (_, port) = self._socket.recvfrom(65_536)
            source = _Address(socket.AF_INET, socket.htons(port), 0x0100007F)
            self._library.controller_take(data, ctypes.c_size_t(len(data)), ctypes.byref(source))
        if due:
            self._library.controller_scan()
            self.next_ns = max(self.next_ns + self._cycle_ns, self._network.now_ns)

    def __enter__(self) -> Self:
        self._network.controllers.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        self._network.controllers.remove(self)
        self._socket.close()


@contextmanager
def ready(*command: str | Path) -> Iterator[dict[str, Any]]:
    """What a program says when it is ready; it is ended at the end."""
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout is not None
        try:
            yield json.loads(process.stdout.readline())
        finally:
            process.terminate()
