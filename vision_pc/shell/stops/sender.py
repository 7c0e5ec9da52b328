"""STOP on the reference link, spoken by the door: beside the vision PC, in its session, from its port.

The door's numbers leap a little ahead of the vision PC's, which goes on behind them once it has been told.
What it had sent in between comes late, and is dropped as if the network had lost it (protocol, 5.2 and 6.3).
"""

import asyncio
import contextlib
import json
import socket
from collections.abc import Awaitable
from http import HTTPStatus
from typing import Any

from foundation.rest.problems import Refusal, RefusalLog, advised, problem_of
from protocol.authentication import LinkKey
from protocol.channel import is_newer
from protocol.client_handshake import Credentials
from protocol.errors import LinkLost
from protocol.faults import CommandCode, FaultCode, GroupState, Reason, refusal
from protocol.reference_messages import FLAG_EMERGENCY_LATCHED, Command
from vision_pc.application.console.advice import advice
from vision_pc.shell.stops.shared import MOST_BYTES, SharedNumbers

CODES = {
    "/stop": CommandCode.STOP,
    "/disable": CommandCode.DISABLE,
    "/emergency-stop": CommandCode.EMERGENCY_STOP,
}
_AHEAD = 4  # numbers: more than the vision PC sends while one is read and used
_AGAIN_S = 0.1
_WITHIN_S = 2.0
_LOOK_S = 0.002
_LOOKS_FOR_STATE = 50
_REPORT_EVERY_S = 0.5
_MOST_APART = 50  # refusals by cause and source; the others are told together


class StopSender:
    """Implements foundation.rest.door.Stops. ``control``: the vision PC's other end of it."""

    def __init__(self, numbers: SharedNumbers, control: socket.socket, key: LinkKey | None) -> None:
        self.ended = asyncio.Event()
        self._numbers, self._control, self._key = numbers, control, key
        self._credentials: Credentials | None = None
        self._link: socket.socket | None = None
        self._next_sequence: int | None = None
        self._next_id = 0
        control.setblocking(False)
        asyncio.get_running_loop().add_reader(control.fileno(), self._hear)

    def begin(self, path: str) -> Awaitable[tuple[int, Refusal]] | None:
        """Send the stop at once; the answer. None without a session."""
        self._hear()
        if self._credentials is None or self._link is None:
            return None
        return self._answer(self._begun(CODES[path]), self._credentials)

    def tell(self, **order: Any) -> None:
        """Tell the vision PC; where it is not heard, that is lost."""
        with contextlib.suppress(OSError):
            self._control.send(json.dumps(order).encode())

    def _begun(self, code: CommandCode) -> Command:
        """A stop that is sent, under an id of its own."""
        command_id = max(self._numbers.next_numbers[1], self._next_id) + _AHEAD
        self._next_id = command_id + 1
        stop = Command(command_id, code)
        self._send(stop)
        return stop

    def _send(self, stop: Command) -> None:
        assert self._credentials is not None
        assert self._link is not None
        sequence = self._numbers.next_numbers[0]
        if self._next_sequence is not None and is_newer(self._next_sequence, sequence):
            sequence = self._next_sequence
        channel = self._credentials.channel(self._key, sequence + _AHEAD)
        datagram = channel.encoded(stop, self._numbers.time_ns)
        self._next_sequence = channel.next_sequence
        with contextlib.suppress(OSError):  # nobody listens there: it is sent again
            self._link.send(datagram)
        # Told after that, or the vision PC's next datagram comes before this one, which is then late.
        self.tell(stop=stop.command_id, code=stop.code, next_sequence=self._next_sequence)

    async def _answer(self, stop: Command, credentials: Credentials) -> tuple[int, Refusal]:
        """What the controller answers, as a response."""
        loop = asyncio.get_running_loop()
        name = CommandCode(stop.code).name.lower().replace("_", " ")
        until_s, again_s = loop.time() + _WITHIN_S, loop.time() + _AGAIN_S
        while loop.time() < until_s and self._credentials == credentials:
            await asyncio.sleep(_LOOK_S)
            reason = self._numbers.reason_of(stop.command_id)
            if reason in (Reason.ACCEPTED, Reason.ALREADY_DONE):
                return HTTPStatus.OK, await self._accepted(Reason(reason))
            if reason == Reason.OVERTAKEN:  # by another request: it came late
                stop = self._begun(CommandCode(stop.code))
            elif reason is not None:
                return _as_response(problem_of(refusal(name, Reason(reason), 0.0, 0.0, ""), {}))
            elif self._numbers.clock_held:
                return HTTPStatus.ACCEPTED, {"accepted": True, "reason": "clock_held"}
            elif loop.time() > again_s:
                again_s += _AGAIN_S
                self._send(stop)
        why = f"{name} was sent; the controller has not answered within {_WITHIN_S:g} s"
        return _as_response(problem_of(LinkLost("link.unanswered", why), {}))

    async def _accepted(self, reason: Reason) -> dict[str, Any]:
        """The answer, with the first state after it, where one comes soon."""
        seen = self._numbers.state[0]
        for _ in range(_LOOKS_FOR_STATE):
            if self._numbers.state[0] != seen:
                break
            await asyncio.sleep(_LOOK_S)
        _, group_state, fault, flags = self._numbers.state
        return {
            "accepted": True,
            "reason": reason.name.lower(),
            "group_state": GroupState(group_state).name.lower(),
            "fault": FaultCode(fault).name.lower(),
            "emergency_latched": bool(flags & FLAG_EMERGENCY_LATCHED),
        }

    def _hear(self) -> None:
        """Read what the vision PC says: the session that is open, and the socket of the link."""
        while True:
            try:
                data, descriptors, _, _ = socket.recv_fds(self._control, MOST_BYTES, 1)
            except BlockingIOError:
                return
            except OSError:
                data, descriptors = b"", []
            if not data:
                asyncio.get_running_loop().remove_reader(self._control.fileno())
                self.ended.set()
                return
            order = json.loads(data)
            if descriptors:
                if self._link is not None:
                    self._link.close()
                self._link = socket.socket(fileno=descriptors[0])
            if "session" in order:
                self._credentials = Credentials(*order["session"]) if order["session"] else None
                self._next_sequence = None


class ToldRefusals(RefusalLog):
    """Tells the vision PC what was refused, from time to time; it counts them, and has the log."""

    def __init__(self, sender: StopSender) -> None:
        super().__init__(None)
        self._sender = sender
        self._new: dict[tuple[str, str], tuple[Refusal, int]] = {}

    def tell(self, refusal: Refusal, source: str, count: int = 1) -> None:
        """So many more."""
        if not self._new:
            asyncio.get_running_loop().call_later(_REPORT_EVERY_S, self._pass_on)
        kind = refusal["cause"], source
        if kind not in self._new and len(self._new) >= _MOST_APART:
            kind = refusal["cause"], "others"
        self._new[kind] = refusal, self._new.get(kind, (refusal, 0))[1] + count

    def _pass_on(self) -> None:
        refused = [[refusal, source, count] for (_, source), (refusal, count) in self._new.items()]
        self._new.clear()
        self._sender.tell(refused=refused)


def _as_response(document: dict[str, Any]) -> tuple[int, Refusal]:
    return document["status"], advised(document, advice)
