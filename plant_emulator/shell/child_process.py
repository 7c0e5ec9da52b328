"""A process beside the plant's own, for what must not hold its loop or its interpreter lock."""

import contextlib
import socket
import subprocess
import sys

from pydantic import BaseModel

_END_TIMEOUT_S = 0.5


def started(
    module: str, settings: BaseModel, listener: socket.socket, link: socket.socket, scheduling: str
) -> subprocess.Popen[bytes]:
    """``python -m module``, which takes ``settings`` as JSON on stdin and takes over both sockets.

    They are closed here. ``scheduling`` is what it asks of the kernel.
    """
    with listener, link:
        inherited = (listener.fileno(), link.fileno())
        process = subprocess.Popen(
            [sys.executable, "-m", module, *map(str, inherited), scheduling],
            stdin=subprocess.PIPE,
            pass_fds=inherited,
        )
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError), process.stdin as stdin:
        stdin.write(settings.model_dump_json().encode())
    return process


def ended(process: subprocess.Popen[bytes]) -> None:
    """Wait for a process that has been told to end; kill it after half a second."""
    try:
        process.wait(_END_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
