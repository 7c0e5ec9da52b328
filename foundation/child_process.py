"""A process beside a service's own, for what must not hold its loop or its interpreter lock."""

import contextlib
import subprocess
import sys
from collections.abc import Iterable

_END_TIMEOUT_S = 0.5


def started(module: str, given: bytes, inherited: Iterable[int], *arguments: str) -> subprocess.Popen[bytes]:
    """``python -m module``, which gets ``given`` on stdin, and takes over the descriptors ``inherited``.

    They are its first arguments, but for words behind the module's name; the caller closes its own.
    """
    descriptors = tuple(inherited)
    process = subprocess.Popen(
        [sys.executable, "-m", *module.split(), *map(str, descriptors), *arguments],
        stdin=subprocess.PIPE,
        pass_fds=descriptors,
    )
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError), process.stdin as stdin:
        stdin.write(given)
    return process


def ended(process: subprocess.Popen[bytes]) -> None:
    """Wait for a process that has been told to end; kill it after half a second."""
    try:
        process.wait(_END_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
