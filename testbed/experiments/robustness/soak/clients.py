"""Clients beside the one that works: a poller of the state, and followers of whatever operation runs."""

import threading
import time

import httpx
import numpy as np

from testbed.experiments.robustness.soak.incidents import Journal
from testbed.realtime.rest_rig import bearer

POLLS_HZ = 20.0
FOLLOWERS = 2
_TIMEOUT_S = 5.0
_RETRY_S = 0.2


class _Client(threading.Thread):
    """A client in a thread of its own, until ended."""

    def __init__(self, url: str, token: bytes | None, journal: Journal) -> None:
        super().__init__(daemon=True)
        self._http = httpx.Client(base_url=url, timeout=_TIMEOUT_S, headers=bearer(token))
        self._journal = journal
        self._ended = threading.Event()

    def end(self) -> None:
        """End the thread and close its connection."""
        self._ended.set()
        self.join(2.0 * _TIMEOUT_S)
        self._http.close()

    def _note(self, who: str, answer: httpx.Response) -> None:
        if not answer.is_success:
            said = answer.json()
            self._journal.incident(who, str(said.get("cause")), str(said.get("detail")))


class Poller(_Client):
    """Reads ``/state`` at ``POLLS_HZ``; ``waits_ms`` is how long each answer took."""

    def __init__(self, url: str, token: bytes | None, journal: Journal) -> None:
        super().__init__(url, token, journal)
        self.waits_ms: list[float] = []

    def run(self) -> None:
        """The thread's work."""
        next_s = time.monotonic()
        while not self._ended.wait(max(next_s - time.monotonic(), 0.0)):
            next_s = max(next_s + 1.0 / POLLS_HZ, time.monotonic() - 1.0)
            asked_s = time.monotonic()
            try:
                answer = self._http.get("/state")
            except httpx.HTTPError as error:
                self._journal.incident("poller", "link.rest", repr(error))
                continue
            self.waits_ms.append(1e3 * (time.monotonic() - asked_s))
            self._note("poller", answer)

    def percentiles_ms(self) -> tuple[float, float, float]:
        """Half, 99 % and all of the answers came within these times; NaN where none came."""
        if not self.waits_ms:
            return (float("nan"),) * 3
        half, high, top = np.percentile(self.waits_ms, [50, 99, 100])
        return float(half), float(high), float(top)


class Follower(_Client):
    """Follows the events of the newest operation to its end, then those of the next."""

    def __init__(self, url: str, token: bytes | None, journal: Journal) -> None:
        super().__init__(url, token, journal)
        self.events = 0
        self.followed = 0

    def run(self) -> None:
        """The thread's work."""
        seen = ""
        while not self._ended.is_set():
            try:
                operations = self._http.get("/operations").json()
                newest = operations[-1]["id"] if operations else seen
                if newest == seen:
                    self._ended.wait(_RETRY_S)
                    continue
                seen = newest
                self._follow(newest)
            except (httpx.HTTPError, ValueError) as error:
                self._journal.incident("follower", "link.rest", repr(error))
                self._ended.wait(_RETRY_S)

    def _follow(self, operation: str) -> None:
        path = f"/operations/{operation}/events"
        with self._http.stream("GET", path, timeout=httpx.Timeout(_TIMEOUT_S, read=60.0)) as stream:
            if not stream.is_success:
                stream.read()
                self._note("follower", stream)
                return
            for line in stream.iter_lines():
                self.events += line.startswith("event:")
                if self._ended.is_set():
                    return
        self.followed += 1
