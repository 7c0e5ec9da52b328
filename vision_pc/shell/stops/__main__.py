"""The door's process: ``python -m vision_pc.shell.stops LISTENER CONTROL MEMORY``, started by the vision PC.

It takes over the descriptors of the REST port, of its link to the vision PC and of the numbers that they
share, and its settings on stdin; it ends when the vision PC does.
"""

import asyncio
import pickle
import signal
import socket
import sys

import uvloop

from foundation.rest.door import Door
from foundation.rest.guard import Guard
from vision_pc.application.console.advice import advice
from vision_pc.shell.stops.sender import StopSender, ToldRefusals
from vision_pc.shell.stops.shared import Given, SharedNumbers


async def _serve(given: Given, listener: socket.socket, sender: StopSender) -> None:
    access = given.access._replace(advise=advice)
    door = Door(given.service, Guard(access, ToldRefusals(sender)), access.stops, sender)
    await door.serve(listener)
    await sender.ended.wait()


def main() -> int:
    """Exit status of the process."""
    # A signal to the whole process group reaches the vision PC too, which then closes its end of the link.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    listener, control = (socket.socket(fileno=int(each)) for each in sys.argv[1:3])
    given: Given = pickle.load(sys.stdin.buffer)  # from the vision PC alone

    async def serve() -> None:
        await _serve(given, listener, StopSender(SharedNumbers(int(sys.argv[3])), control, given.key))

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(serve())
    return 0


if __name__ == "__main__":
    sys.exit(main())
