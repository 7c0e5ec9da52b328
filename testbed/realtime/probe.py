"""Asks a service whether it answers, without disturbing it.

``python -m testbed.realtime.probe WHAT HOST PORT [--token-file FILE]``. For health checks of
containers: it starts quickly, prints one line, and its exit status says all.
``fieldbus`` reads one register, ``reference`` sends a datagram of no session (the controller names the
mistake), ``rest`` wants the vision PC to have both controller and camera.
"""

import argparse
import http.client
import json
import secrets
import socket
import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path

from protocol.datagram import Header, decode, encode
from protocol.errors import DatagramRefused
from protocol.reference_messages import Bye, Heartbeat

TIMEOUT_S = 2.0
_TRANSACTION = 0x4C52
_READ_HOLDING = 3


class Unhealthy(Exception):
    """The service did not answer as it should."""


def probe_fieldbus(host: str, port: int) -> str:
    """What the coupler answered to reading its first register. Raises Unhealthy or OSError."""
    request = struct.pack(">HHHBBHH", _TRANSACTION, 0, 6, 1, _READ_HOLDING, 0, 1)
    with socket.create_connection((host, port), TIMEOUT_S) as connection:
        connection.sendall(request)
        answer = connection.recv(64)
    if len(answer) != 11 or answer[:2] != request[:2] or answer[7] != _READ_HOLDING:
        raise Unhealthy(f"unexpected answer {answer.hex()}")
    return f"register 0 reads {int.from_bytes(answer[9:11], 'big')}"


def probe_reference(host: str, port: int) -> str:
    """What the controller answered to a datagram of no session. Raises Unhealthy or OSError."""
    stray = encode(Heartbeat(time.monotonic_ns()), Header(secrets.randbits(63) | 1, 1, time.monotonic_ns()))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.settimeout(TIMEOUT_S)
        peer.connect((host, port))
        peer.send(stray)
        try:
            answer = decode(peer.recv(2048)).message
        except DatagramRefused as error:
            raise Unhealthy(f"unexpected answer: {error}") from error
    if not isinstance(answer, Bye):
        raise Unhealthy(f"unexpected answer {type(answer).__name__}")
    return f"controller answers {answer.reason.name}"


def probe_rest(host: str, port: int, token_file: Path | None = None) -> str:
    """What the vision PC says about its own health. Raises Unhealthy, or OSError also for the file."""
    # Sent as it stands: whether it is a good token the service says, and what checks files is slow to import.
    headers = {} if token_file is None else {"Authorization": f"Bearer {token_file.read_text().strip()}"}
    connection = http.client.HTTPConnection(host, port, timeout=TIMEOUT_S)
    try:
        connection.request("GET", "/health", headers=headers)
        response = connection.getresponse()
        document = json.loads(response.read())
    except (http.client.HTTPException, ValueError) as error:
        raise Unhealthy(f"no HTTP answer: {error}") from error
    finally:
        connection.close()
    if response.status != http.HTTPStatus.OK:
        raise Unhealthy(str(document.get("detail", document)))
    return "controller and camera answer"


PROBES: dict[str, Callable[..., str]] = {
    "fieldbus": probe_fieldbus,
    "reference": probe_reference,
    "rest": probe_rest,
}


def main(argv: list[str] | None = None) -> int:
    """Exit status: 0 when the service answers, 1 when it does not."""
    parser = argparse.ArgumentParser(prog="python -m testbed.realtime.probe", description=__doc__)
    parser.add_argument("what", choices=PROBES)
    parser.add_argument("host")
    parser.add_argument("port", type=int)
    parser.add_argument("--token-file", type=Path, help="for rest: the token of a role")
    given = parser.parse_args(argv)
    where, token = f"{given.what} at {given.host}:{given.port}", (given.token_file,)
    try:
        answer = PROBES[given.what](given.host, given.port, *(token if given.what == "rest" else ()))
    except (Unhealthy, OSError, ValueError) as error:
        print(f"{where}: {error}", file=sys.stderr)
        return 1
    print(f"{where}: {answer}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
