"""A relay whose connections can be stranded: open, and nothing comes, as after a computer has slept."""

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

_CHUNK_BYTES = 65_536


class StrandingRelay:
    """Carries connections to ``port`` of this machine; those that are stranded never end by themselves."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._listening = socket.create_server(("127.0.0.1", 0), backlog=64)
        self._pairs: list[tuple[socket.socket, socket.socket]] = []
        self._stranded: set[int] = set()
        self._threads: list[threading.Thread] = []
        self._begin(self._accept)

    @property
    def url(self) -> str:
        """Where it listens."""
        return f"http://127.0.0.1:{self._listening.getsockname()[1]}"

    def strand(self) -> int:
        """Carry nothing more over the connections of now; return how many. New ones are carried."""
        new = set(range(len(self._pairs))) - self._stranded
        self._stranded |= new
        return len(new)

    def close(self) -> None:
        """End all."""
        every = [self._listening]
        _shut(self._listening)
        self._threads[0].join()
        every += [end for pair in self._pairs for end in pair]
        for end in every:
            _shut(end)
        for thread in self._threads:
            thread.join()
        for end in every:
            end.close()

    def _begin(self, work: Callable[..., None], *given: Any) -> None:
        self._threads.append(threading.Thread(target=work, args=given))
        self._threads[-1].start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._listening.accept()
                server = socket.create_connection(("127.0.0.1", self._port))
                number = len(self._pairs)
                self._pairs.append((client, server))
                self._begin(self._carry, number, client, server)
                self._begin(self._carry, number, server, client)

    def _carry(self, number: int, source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(_CHUNK_BYTES):
                if number not in self._stranded:
                    sink.sendall(data)
        if number not in self._stranded:
            _shut(sink)


def _shut(end: socket.socket) -> None:
    with contextlib.suppress(OSError):
        end.shutdown(socket.SHUT_RDWR)


@contextlib.contextmanager
def stranding(port: int) -> Iterator[StrandingRelay]:
    """A relay before ``port``."""
    with contextlib.closing(StrandingRelay(port)) as relay:
        yield relay
