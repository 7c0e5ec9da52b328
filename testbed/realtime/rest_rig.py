"""The vision PC's REST API as the demonstration drives it: commands, operations with progress, pictures."""

import threading
import time
import uuid
from typing import Any

import httpx
import numpy as np

from protocol.errors import LinkLost, LongreachError, MeasurementFailed, MotionUnsettled, RequestRefused
from testbed.realtime.parsed_results import RESULT_OF, look_of
from testbed.reporting.console import Bar
from testbed.reporting.plots import TracedView
from vision_pc.core.se3 import Array
from vision_pc.core.types import Look

JSON = dict[str, Any]
_POLL_S = 0.2
_TIMEOUT_S = 10.0
_KINDS: dict[str, type[LongreachError]] = {
    "measurement": MeasurementFailed,
    "motion": MotionUnsettled,
    "refused": RequestRefused,
    "link": LinkLost,
}


class RestRig:
    """Implements the sequence's ``Rig`` over HTTP, for services on this machine: one monotonic clock.

    ``token``: of the role ``operate``, where the service wants one.
    """

    def __init__(self, url: str, token: bytes | None = None) -> None:
        self._client = httpx.Client(base_url=url, timeout=_TIMEOUT_S, headers=bearer(token))

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def command(self, name: str) -> None:
        """Send the command. Returns when it is accepted; raises what the problem document says."""
        self._ask("POST", f"/{name}")

    def operate(self, kind: str, body: JSON, bar: Bar) -> Any:
        """The typed result of a program. Raises what its problem document says."""
        return RESULT_OF.get(kind, dict)(self.result(kind, body, bar))

    def result(self, kind: str, body: JSON, bar: Bar) -> JSON:
        """The result of an operation as the API gives it. Raises what its problem document says."""
        key = {"Idempotency-Key": uuid.uuid4().hex}
        operation = self._ask("POST", f"/operations/{kind}", json=body, headers=key)
        while operation["state"] in ("queued", "running"):
            bar.update(operation["progress"], operation["note"])
            time.sleep(_POLL_S)
            operation = self._ask("GET", f"/operations/{operation['id']}")
        if operation["state"] == "succeeded":
            result: JSON = operation["result"]
            return result
        problem = operation["problem"] or {"cause": "refused.cancelled", "detail": f"{kind} was cancelled"}
        raise error_of(problem)

    def latest_look(self) -> Look:
        """The latest look of any program."""
        return look_of(self._ask("GET", "/looks/latest")).look

    def holes(self) -> list[tuple[Array, Array]]:
        """All drill holes of the newest picture: middle in the left eye's, px (2,), and in C (3,)."""
        found = self._ask("GET", "/targets", params={"detect": True})["holes"]
        return [(np.array(hole["at"]), np.array(hole["p_C_m"])) for hole in found]

    def target_at(self, pixel: Array) -> str:
        """The id of the hole at ``pixel`` (2,) of a fresh left picture, from now on a target."""
        u, v = (float(value) for value in pixel)
        made = self._ask("POST", "/targets", json={"u_px": u, "v_px": v, "kind": "hole"})
        return str(made["id"])

    def state(self) -> JSON:
        """The controller's newest state."""
        return self._ask("GET", "/state")

    def picture(self) -> bytes:
        """The newest picture with detections, PNG."""
        return self._response("GET", "/camera/latest.png").content

    def now_ns(self) -> int:
        """The machine's monotonic clock."""
        return time.monotonic_ns()

    def wait_healthy(self, timeout_s: float) -> None:
        """Wait until controller and camera respond and a picture has come.

        Raises LinkLost with what is missing.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                self._ask("GET", "/health")
                self.picture()
            except LinkLost as error:
                if time.monotonic() > deadline:
                    raise LinkLost(error.cause, f"not healthy after {timeout_s:.0f} s: {error}") from error
                time.sleep(_POLL_S)
            else:
                return

    def _ask(self, method: str, path: str, **request: Any) -> JSON:
        answer: JSON = self._response(method, path, **request).json()
        return answer

    def _response(self, method: str, path: str, **request: Any) -> httpx.Response:
        try:
            response = self._client.request(method, path, **request)
        except httpx.HTTPError as error:
            why = f"{method} {self._client.base_url}{path}: {error}; `longreach up` starts the three services"
            raise LinkLost("link.rest", why) from error
        if response.is_success:
            return response
        try:
            problem = response.json()
        except ValueError:
            problem = {"cause": f"rest.{response.status_code}", "detail": response.reason_phrase}
        raise error_of(problem)


def bearer(token: bytes | None) -> dict[str, str]:
    """The header that presents ``token``; none without."""
    return {} if token is None else {"Authorization": f"Bearer {token.hex()}"}


def error_of(problem: JSON) -> LongreachError:
    """The exception for an RFC 9457 problem document; its kind follows from the cause's first word."""
    cause = str(problem.get("cause", "rest.unknown"))
    kind = _KINDS.get(cause.split(".")[0], LongreachError)
    return kind(cause, str(problem.get("detail") or problem.get("title") or cause))


class StateSampler:
    """Samples the controller's state in the background, for the report's curves.

    ``views``, ``cycle`` (the controller's timing, newest) and ``overload`` (what was last said of it, if
    anything) are complete after the block.
    """

    def __init__(self, url: str, token: bytes | None = None, period_s: float = 0.1) -> None:
        self.views: list[TracedView] = []
        self.cycle: JSON | None = None
        self.overload = ""
        self._rig = RestRig(url, token)
        self._period_s = period_s
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> "StateSampler":
        self._thread.start()
        return self

    def __exit__(self, *_exception: object) -> None:
        self._ended.set()
        self._thread.join()
        self._rig.close()

    def _run(self) -> None:
        while not self._ended.wait(self._period_s):
            try:
                state = self._rig.state()
            except LongreachError:
                continue  # told by whoever drives; a curve may have a gap
            joints = (np.radians(state[key]).tolist() for key in ("q_cmd_deg", "q_meas_deg"))
            self.views.append(TracedView(time.monotonic_ns(), state["X_BT"]["p_m"], *joints))
            self.cycle = state["cycle"]
            self.overload = state["overload"] or self.overload
