"""The vision PC's end of its door: starts the process, tells it what a STOP takes, hears what it has sent."""

import asyncio
import contextlib
import json
import os
import pickle
import socket
from collections.abc import Callable
from typing import Any

from foundation import clock
from foundation.child_process import ended, started
from foundation.rest.guard import Access
from foundation.rest.problems import RefusalLog
from protocol.authentication import LinkKey
from protocol.faults import CommandCode
from protocol.reference_messages import Command
from protocol.session_events import (
    AcknowledgementReceived,
    ClientEvent,
    Connected,
    SessionLost,
    StateReceived,
)
from vision_pc.application.reference_link import ReferenceLink, Streamed, Submitted
from vision_pc.shell.stops.shared import MOST_BYTES, Given, SharedNumbers, new_memory


class DoorProcess:
    """The door at ``listener``, which it takes over, to the service at the path ``service``.

    ``stopped`` is called after it has sent a stop of its own; ``gone`` when it has ended.
    """

    def __init__(
        self, listener: socket.socket, service: str, access: Access, key: LinkKey | None, refusals: RefusalLog
    ) -> None:
        memory = new_memory()
        self._numbers = SharedNumbers(memory)
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._control.setblocking(False)
        self._refusals = refusals
        self._link: ReferenceLink | None = None
        self.stopped: Callable[[], None] = lambda: None
        self.gone: Callable[[], None] = lambda: None
        given = Given(service, access._replace(advise=None, tokens=dict(access.tokens)), key)
        inherited = (listener.fileno(), theirs.fileno(), memory)
        listener.listen()  # from now on: a process that is slow to start keeps its callers waiting
        with listener, theirs:
            self._process = started("vision_pc.shell.stops", pickle.dumps(given), inherited)
        os.close(memory)

    def hold_clock(self, held: bool) -> None:
        """Tell it that a person holds the clock, or lets it go."""
        self._numbers.clock_held = held

    def attach(self, link: ReferenceLink) -> None:
        """Have it stop over ``link``. In the loop that the link lives in."""
        self._link = link
        link.listeners.append(self._on_heard)
        asyncio.get_running_loop().add_reader(self._control.fileno(), self.hear)

    def opened(self, sock: socket.socket) -> None:
        """The link's socket is another one now."""
        with contextlib.suppress(OSError):
            socket.send_fds(self._control, [b"{}"], [sock.fileno()])

    def sent(self, link: ReferenceLink) -> None:
        """The link has sent: its next numbers are these."""
        self._numbers.next_numbers = link.session.next_numbers

    def hear(self) -> None:
        """Read all that it has said."""
        while True:
            try:
                data = self._control.recv(MOST_BYTES)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                asyncio.get_running_loop().remove_reader(self._control.fileno())
                self.gone()
                return
            self._receive(json.loads(data))

    def close(self) -> None:
        """End it."""
        asyncio.get_running_loop().remove_reader(self._control.fileno())
        self._control.close()
        ended(self._process)

    def _receive(self, order: dict[str, Any]) -> None:
        for refusal, source, count in order.get("refused", ()):
            self._refusals.tell(refusal, source, count)
        if "stop" in order and self._link is not None and self._link.session.credentials is not None:
            self._link.take_over(Command(order["stop"], CommandCode(order["code"])), order["next_sequence"])
            self.stopped()

    def _on_heard(self, event: Submitted | Streamed | ClientEvent) -> None:
        assert self._link is not None
        if not clock.is_wall():
            self._numbers.time_ns = clock.now_ns()
        if isinstance(event, AcknowledgementReceived):
            self._numbers.answer(event.acknowledgement.command_id, event.acknowledgement.reason)
        elif isinstance(event, StateReceived):
            self._numbers.tell_state(event.state.group_state, event.state.fault, event.state.flags)
        elif isinstance(event, Connected):
            self.sent(self._link)
            self._send(session=self._link.session.credentials)
        elif isinstance(event, SessionLost):
            self._send(session=None)

    def _send(self, **order: Any) -> None:
        with contextlib.suppress(OSError):  # it has ended
            self._control.send(json.dumps(order).encode())
