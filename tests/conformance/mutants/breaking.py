"""What a broken controller is made of."""

from typing import Any, NamedTuple

from protocol import channel
from protocol.command_ledger import CommandLedger
from protocol.datagram import Header, decode, encode
from protocol.faults import CommandCode
from protocol.reference_messages import Command, Request
from protocol.server_session import ReferenceServer
from tests.conformance.controllers import ControllerUnderTest

# Offsets in the header of a datagram.
MAJOR, MINOR, FLAGS, LENGTH, SEQUENCE, ECHO, HEADER_BYTES = 4, 5, 8, 10, 24, 28, 40


class Mutant(NamedTuple):
    """A broken controller and the case that is meant to catch it."""

    make: type[ControllerUnderTest]
    case: int


def reworked(data: bytes, kind: type, rework: Any) -> bytes:
    """``data`` with its message replaced by ``rework(message)`` if it is of ``kind``."""
    header, message = decode(data)
    return encode(rework(message), header) if isinstance(message, kind) else data


def with_ledger(server: ReferenceServer, ledger: type[CommandLedger]) -> ReferenceServer:
    def granted(*args: Any) -> Any:
        session = original(*args)
        session.ledger = ledger()
        return session

    original = server._granted
    server._granted = granted
    return server


def with_window(server: ReferenceServer, window: type[channel.SequenceWindow]) -> ReferenceServer:
    def granted(header: Header, *args: Any) -> Any:
        session = original(header, *args)
        session.channel._window = window(header.sequence)
        return session

    original = server._granted
    server._granted = granted
    return server


def says(code: CommandCode, request: Request) -> bool:
    """Whether ``request`` is the command ``code``."""
    return isinstance(request, Command) and request.code is code
