"""A rig behind the REST API: its operations, and looks as the type of the programs."""

import math
import re
import time
import uuid
from typing import Any

import httpx
import numpy as np

from foundation.foreign_text import parse_json
from protocol.errors import LinkLost, LongreachError, MeasurementFailed, MotionUnsettled, RequestRefused
from protocol.pose import Pose
from testbed.reporting.console import Bar
from vision_pc.application.results import JSON, JudgedLook
from vision_pc.core.positioning.look_then_move import LookVerdict
from vision_pc.core.se3 import Array, from_pose
from vision_pc.core.types import Look, MisplacedMarker, StereoOffset


def look_of(answer: JSON) -> JudgedLook:
    """A look with its verdict. The API tells standard deviations alone: each is taken for independent.

    What one frame's noise was, and how sure the offset of the eyes is, it does not tell: NaN.
    """
    offset_px, unknown = answer["stereo_offset_px"], np.full((6, 6), math.nan)
    offset = None
    if offset_px is not None:
        x_px, y_px = offset_px
        offset = StereoOffset(x_px, y_px, math.nan, math.nan)
    look = Look(
        time_ns=int(answer["time_ns"]),
        X_CM=_pose(answer["X_CM"]),
        X_CO=_pose(answer["X_CO"]),
        X_BT=_pose(answer["X_BT"]),
        frames=answer["frames"],
        failed_tool=answer["failed_tool"],
        failed_object=answer["failed_object"],
        cov_CM=_spread(answer["std_tool_mm"], answer["std_tool_deg"]),
        cov_CO=_spread(answer["std_object_mm"], answer["std_object_deg"]),
        frame_cov_CM=unknown,
        frame_cov_CO=unknown,
        offset=offset,
        misplaced=_misplaced(answer["misplaced_marker"]),
    )
    return JudgedLook(look, _verdict(answer))


def _misplaced(answer: JSON | None) -> MisplacedMarker | None:
    if answer is None:
        return None
    off, std = (1e-3 * np.array([answer[name]["x"], answer[name]["y"]]) for name in ("off_mm", "std_mm"))
    return MisplacedMarker(answer["id"], off, std)


def _spread(std_mm: JSON, std_deg: JSON) -> Array:
    return np.diag(np.concatenate((_metres(std_mm), np.radians(_xyz(std_deg)))) ** 2)


def _verdict(answer: JSON) -> LookVerdict:
    return LookVerdict(
        _metres(answer["error_mm"]),
        np.diag(_metres(answer["std_mm"]) ** 2),
        1e-3 * answer["tolerance_mm"],
        answer["clearance_m"],
        answer["verdict"] == "inside",
        answer["certain"],
    )


def _pose(answer: JSON) -> Array:
    x, y, z = answer["p_m"]
    w, i, j, k = answer["q_wxyz"]
    return from_pose(Pose((x, y, z), (w, i, j, k)))


def _xyz(answer: JSON) -> Array:
    return np.array([answer[axis] for axis in "xyz"])


def _metres(answer: JSON) -> Array:
    return 1e-3 * _xyz(answer)


_POLL_S = 0.2
_TIMEOUT_S = 10.0
_KINDS: dict[str, type[LongreachError]] = {
    "measurement": MeasurementFailed,
    "motion": MotionUnsettled,
    "refused": RequestRefused,
    "link": LinkLost,
}


class RestRig:
    """Implements the sequence's ``Rig`` over HTTP.

    ``token``: of the role ``operate``, where the service wants one.
    """

    def __init__(self, url: str, token: bytes | None = None) -> None:
        self._client = rest_client(url, token)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def command(self, name: str) -> None:
        """Send the command. Returns when it is accepted; raises what the problem document says."""
        self._ask("POST", f"/{name}")

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

    def state(self) -> JSON:
        """The controller's newest state."""
        return self._ask("GET", "/state")

    def picture(self) -> bytes:
        """The newest picture with detections, PNG."""
        return self._response("GET", "/camera/latest.png").content

    def now_ns(self) -> int:
        """The time on the vision PC's clock."""
        return int(self._ask("GET", "/clock")["time_ns"])

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
        return answered(self._response(method, path, **request))

    def _response(self, method: str, path: str, **request: Any) -> httpx.Response:
        asked = self._client.build_request(method, path, **request)
        try:
            response = self._client.send(asked)
        except httpx.HTTPError as error:
            said = re.sub(r"^\[Errno -?\d+\] ", "", str(error)).rstrip(".")
            if "SSL" in said or isinstance(error, httpx.RemoteProtocolError):
                said = "no whole answer in HTTP came: it has ended, or http:// and https:// are mixed up"
            why = f"{method} {_shown(asked.url)}: {said}; `longreach up` starts the three services"
            raise LinkLost("link.rest", why) from error
        if not response.is_success:
            raise error_of(answered(response))
        return response


def rest_client(url: str, token: bytes | None) -> httpx.Client:
    """Of the service at ``url``: the token is for it alone, whatever proxy the environment names.

    Raises LinkLost (``link.rest``) for an address that is none.
    """
    presents = {} if token is None else {"Authorization": f"Bearer {token.hex()}"}
    try:
        address = httpx.URL(url)
        if address.port is not None and not 0 < address.port < 1 << 16:
            raise httpx.InvalidURL(f"port {address.port} is not within 1…65535")
        if address.scheme not in ("http", "https") or not address.host or address.query:
            raise httpx.InvalidURL("scheme and host alone make the address of a service")
        return httpx.Client(base_url=address, timeout=_TIMEOUT_S, headers=presents, trust_env=False)
    except httpx.InvalidURL as error:
        raise LinkLost("link.rest", f"{url!r}: {error}; wanted http://HOST:PORT") from error


def answered(response: httpx.Response) -> JSON:
    """The object that a service of ours answers with. Raises LinkLost where somebody else answers."""
    try:
        answer = parse_json(response.text)
    except ValueError:
        answer = None
    if isinstance(answer, dict):
        return ServiceAnswer(response, answer)
    leads = f", which leads to {response.headers['location']}" if response.has_redirect_location else ""
    raise _foreign(response, f"{leads}, and no object of JSON")


class ServiceAnswer(dict[str, Any]):
    """An object that was answered. A key that it lacks raises LinkLost: somebody else answered."""

    def __init__(self, response: httpx.Response, answer: JSON) -> None:
        super().__init__(answer)
        self._response = response

    def __missing__(self, key: str) -> Any:
        raise _foreign(self._response, f" with no {key!r} in it")


def _foreign(response: httpx.Response, what: str) -> LinkLost:
    why = f"{_shown(response.request.url)}: {response.status_code} {response.reason_phrase}{what}"
    return LinkLost(f"rest.{response.status_code}", f"{why}: something else than Longreach answers")


def _shown(url: httpx.URL) -> str:
    """Without a password."""
    return str(url.copy_with(username=None, password=None))


def error_of(problem: JSON) -> LongreachError:
    """The exception for an RFC 9457 problem document; its kind follows from the cause's first word."""
    cause = str(problem.get("cause", "rest.unknown"))
    kind = _KINDS.get(cause.split(".")[0], LongreachError)
    return kind(cause, str(problem.get("detail") or problem.get("title") or cause))
