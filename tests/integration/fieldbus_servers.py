"""``python -m tests.integration.fieldbus_servers NAME``: a Modbus TCP server that says its port."""

import asyncio
import socket
import sys
import threading
import time

import uvloop


async def coupler() -> None:
    """Our coupler, as the plant serves it."""
    from plant_emulator.shell.coupler import Coupler
    from protocol.process_image import SensorImage, encode_sensors

    words = encode_sensors(SensorImage(7, 9, 5, (1, 2, 3, 4, 5, 6), ((1.0, 2.0),) * 6, 190.0, 10.0, 40.0))
    served = Coupler(lambda: words, lambda _: None, 60_000_000_000, time.monotonic_ns)
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        print((await served.start(bound))[1], flush=True)
        await asyncio.Event().wait()


async def pymodbus() -> None:
    """pymodbus's own server, with a small plant behind it."""
    from tests.controller.shell.plant_server import plant_server

    async with plant_server() as server:
        print(server.port, flush=True)
        await asyncio.Event().wait()


def pymodbustcp() -> None:
    """pyModbusTCP's server, with a thread for each client."""
    from pyModbusTCP.server import ModbusServer

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    ModbusServer("127.0.0.1", port, no_block=True).start()
    print(port, flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    if sys.argv[1] == "pymodbustcp":
        pymodbustcp()
    else:
        with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
            runner.run({"coupler": coupler, "pymodbus": pymodbus}[sys.argv[1]]())
