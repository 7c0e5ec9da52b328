"""What the machine does in a soak: vision looks all the while, the arm moves once a minute."""

import threading
import time
from collections import Counter
from collections.abc import Callable

import httpx
import numpy as np

from laboratory.soak.incidents import Journal
from protocol.errors import LongreachError
from testbed.realtime.rest_rig import RestRig, bearer
from testbed.reporting.console import Bar
from vision_pc.application.results import JSON

_LOOK: JSON = {"frames": 50}  # five seconds of looking at 10 pictures a second
_STROKE_M = 0.15
_MOVE_EVERY_S = 60.0
_CALIBRATE_EVERY = 10  # motions
_IN_WARM_UP = 2  # motions: odometry takes its working memory over its first few runs
_RECOVERY_S = 30.0
_RETRY_S = 0.5


class Duty:
    """Rest and motion in turns. Whatever fails is noted, the arm is enabled again, and the duty goes on."""

    def __init__(self, rig: RestRig, journal: Journal, bar: Bar, alive: Callable[[], None]) -> None:
        """``alive`` raises when a service has ended."""
        self.done: Counter[str] = Counter()
        self.recoveries_s: list[float] = []
        self._rig = rig
        self._journal = journal
        self._bar = bar
        self._alive = alive
        self._out = False

    def keep(self, seconds: float, warm_up_s: float) -> None:
        """Work for ``seconds``, calibrating more often in the first ``warm_up_s`` of them.

        Raises LongreachError when a service has ended or nothing can be enabled.
        """
        overall = _Overall(self._bar, self._journal, seconds)
        self._recover()
        home = self._rig.state()["X_BT"]
        moves, next_move_s = 0, 0.0
        while self._journal.now_s < seconds:
            if self._journal.now_s < next_move_s:
                self._attempt("look", _LOOK, overall)
                continue
            next_move_s = self._journal.now_s + _MOVE_EVERY_S
            moves += 1
            if moves % (_IN_WARM_UP if self._journal.now_s < warm_up_s else _CALIBRATE_EVERY):
                self._out = not self._out
                self._attempt("move", {"X_BT": _stroke_end(home) if self._out else home}, overall)
            else:
                self._attempt("trajectory-matching", {}, overall)

    def _attempt(self, kind: str, body: JSON, bar: Bar) -> None:
        try:
            self._rig.operate(kind, body, bar)
        except LongreachError as error:
            self._journal.incident(kind, error.cause, str(error))
            self._alive()
            self._recover()
        else:
            self.done[kind] += 1

    def _recover(self) -> None:
        """RESET and ENABLE until the arm is enabled; what is refused on the way is noted.

        Raises the last refusal after half a minute.
        """
        began_s = time.monotonic()
        while True:
            try:
                group = self._rig.state()["group_state"]
                if group == "error_stop":
                    self._rig.command("reset")
                elif group == "disabled":
                    self._rig.command("enable")
                else:
                    self.recoveries_s.append(time.monotonic() - began_s)
                    return
            except LongreachError as error:
                self._journal.incident("recovery", error.cause, str(error))
                self._alive()
                if time.monotonic() - began_s > _RECOVERY_S:
                    raise
                time.sleep(_RETRY_S)


def _stroke_end(home: JSON) -> JSON:
    """The other end of the stroke. By its place: a fault may stop the arm anywhere, and by strokes that were
    counted from where it stood it went away from its object.
    """
    x, y, z = home["p_m"]
    return {"p_m": [x, y + _STROKE_M, z], "q_wxyz": home["q_wxyz"]}


class _Overall(Bar):
    """Shows the time of the whole soak, whatever the running operation reports of itself."""

    def __init__(self, bar: Bar, journal: Journal, seconds: float) -> None:
        self._bar = bar
        self._journal = journal
        self._seconds = seconds

    def update(self, fraction: float, note: str = "") -> None:
        """Set the bar to the share of the time that has passed."""
        self._bar.update(self._journal.now_s / self._seconds, note)


POLLS_HZ = 20.0
FOLLOWERS = 2
_TIMEOUT_S = 5.0
_CLIENT_RETRY_S = 0.2


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
                    self._ended.wait(_CLIENT_RETRY_S)
                    continue
                seen = newest
                self._follow(newest)
            except (httpx.HTTPError, ValueError) as error:
                self._journal.incident("follower", "link.rest", repr(error))
                self._ended.wait(_CLIENT_RETRY_S)

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
