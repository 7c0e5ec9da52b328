"""One service in a container: ``python -m testbed.realtime.contained MODULE ARGUMENT...``.

The engine starts anew what ends with a failure, but tells nobody inside. So this process notes a crash for
the vision PC, then ends with the service's status. Where services record, each start has its own directory.
"""

import itertools
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import FrameType

from foundation.incidents import note_incident
from testbed.realtime.restarts import how_it_ended

RECORDS = "LONGREACH_RECORDS"  # foundation.service_main has it too, and is slow to import
_REFUSED = 2  # a service that does not start with what it is given: its line says why, and it is no crash
_SIGNALLED = 128  # and the signal's number: the exit status, as shells have it


def main(argv: list[str]) -> int:
    """The exit status of the service; SIGTERM and SIGINT are passed on to it."""
    module, *arguments = argv
    if records := os.environ.get(RECORDS):
        arguments += ["--record-dir", str(free_directory(Path(records) / module))]
    service = subprocess.Popen([sys.executable, "-m", module, *arguments])
    terminated = False

    def pass_on(number: int, _frame: FrameType | None) -> None:
        nonlocal terminated
        terminated = True
        service.send_signal(number)

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, pass_on)
    status = service.wait()
    if status not in (0, _REFUSED) and not terminated:
        how = how_it_ended(status, "its log says why" if status > 0 else "")
        note_incident(module, "service.crashed", f"{module} crashed with {how}; it is started anew")
        print(f"{module} crashed with {how}", file=sys.stderr)
    return status if status >= 0 else _SIGNALLED - status


def free_directory(directory: Path) -> Path:
    """``directory``, or with .2, .3, … after it the first that is not there: no start overwrites another."""
    names = (directory.name if number == 1 else f"{directory.name}.{number}" for number in itertools.count(1))
    return next(place for name in names if not (place := directory.with_name(name)).exists())


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
