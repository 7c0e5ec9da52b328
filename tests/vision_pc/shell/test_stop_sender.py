"""A stop that the door sends beside the link is stamped with the link's time, whatever the machine's is."""

import json
import socket
from collections.abc import Coroutine
from typing import Any, cast

from protocol.client_handshake import Credentials
from protocol.datagram import decode
from protocol.datagram_layout import VERSION_MINOR
from protocol.faults import CommandCode
from protocol.reference_messages import Command
from vision_pc.shell.stops.sender import StopSender
from vision_pc.shell.stops.shared import SharedNumbers, new_memory

PLANT_NS = 3_600_000_000_000


async def test_a_stop_by_the_plants_clock_makes_nothing_after_it_look_old() -> None:
    """A machine that has run for two hours stamped it 3,400 s ahead: all else was `datagram.stale`."""
    numbers = SharedNumbers(new_memory())
    numbers.next_numbers, numbers.time_ns = (40, 700), PLANT_NS
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller:
        controller.bind(("127.0.0.1", 0))
        controller.settimeout(5.0)
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        link.connect(controller.getsockname())
        with ours, theirs, link:
            sender = StopSender(numbers, theirs, None)
            session = json.dumps({"session": Credentials(7, VERSION_MINOR, 0, 0)}).encode()
            socket.send_fds(ours, [session], [link.fileno()])
            answer = sender.begin("/stop")
            assert answer is not None
            cast("Coroutine[Any, Any, object]", answer).close()  # nobody answers here
            assert sender._link is not None
            sender._link.close()
            header, message = decode(controller.recv(2048))
    assert isinstance(message, Command)
    assert message.code is CommandCode.STOP
    assert header.sent_ns == PLANT_NS
    numbers.time_ns = 0
    assert numbers.time_ns > 0  # by the wall: the machine's own
