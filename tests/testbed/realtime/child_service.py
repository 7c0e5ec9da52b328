"""A process that behaves as a service, or not: ``python -m tests.testbed.realtime.child_service HOW``."""

import json
import signal
import sys
import threading
from types import FrameType

from foundation.event_log import EventLog


def main(how: str) -> int:
    ended = threading.Event()

    def on_term(_signal: int, _frame: FrameType | None) -> None:
        if how != "stubborn":
            ended.set()

    signal.signal(signal.SIGTERM, on_term)
    if how == "refuses":
        print("configuration.unknown_key: plant.yaml: colour: extra inputs", file=sys.stderr)
        return 2
    if how == "silent":
        ended.wait()
        return 0
    print("a line that is not JSON")
    print(json.dumps({"event": "ready", "port": 1234}), flush=True)
    if how == "dies":
        log = EventLog("service")
        log.write("stopped", "error", cause="oil.lost", detail="the pump ran dry")
        log.close()
        return 3
    if how == "complains":
        log = EventLog("service")
        log.write("noted", "warning", cause="oil.warm", detail="it is warm")
        log.write("stopped", "error", cause="oil.low", detail="the tank is half empty")
    ended.wait()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
