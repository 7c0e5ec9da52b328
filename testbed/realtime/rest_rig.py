"""A rig behind the REST API: its operations, and their results as the types of the programs."""

import math
import threading
import time
import uuid
from collections.abc import Callable
from typing import Any

import httpx
import numpy as np

from protocol.errors import LinkLost, LongreachError, MeasurementFailed, MotionUnsettled, RequestRefused
from protocol.pose import Pose
from testbed.reporting.console import Bar
from testbed.reporting.plots import TracedView
from vision_pc.application.results import JSON, JudgedLook
from vision_pc.core.calibration.local_calibration import LocalCalibration, ResidualTable
from vision_pc.core.calibration.orientation import OrientationResult
from vision_pc.core.positioning.expected_end import ExpectedEnd
from vision_pc.core.positioning.look_then_move import Ended, LookVerdict, PositioningResult, Step
from vision_pc.core.se3 import Array, from_pose
from vision_pc.core.types import Look, MisplacedMarker, StereoOffset


def look_of(answer: JSON) -> JudgedLook:
    """A look with its verdict. The API tells standard deviations alone: each is taken for independent.

    What one frame's noise was, and how sure the offset of the eyes is, it does not tell: NaN. Raises LinkLost
    for a look that was made while no controller was connected: it does not say where the arm stood.
    """
    if answer["X_BT"] is None:
        raise LinkLost("link.not_connected", "look: no controller was connected: arm unknown")
    told_offset, unknown = answer["stereo_offset_px"], np.full((6, 6), math.nan)
    offset = None
    if told_offset is not None:
        x_px, y_px = told_offset
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


def orientation_of(answer: JSON) -> OrientationResult:
    """The errors of an orientation adjustment; the API does not report its references."""
    shifts = tuple(1e-3 * shift for shift in answer["tool_shift_mm"])
    return OrientationResult(tuple(np.radians(_xyz(e)) for e in answer["errors_deg"]), (), shifts)


def calibration_of(answer: JSON) -> LocalCalibration:
    """A local calibration. The API reports the largest standard deviation: taken about every axis here."""
    return LocalCalibration(
        R_BC=np.array(answer["R_BC"]),
        R_TC=None if answer["R_TC"] is None else np.array(answer["R_TC"]),
        covariance=math.radians(answer["rotation_std_deg"]) ** 2 * np.eye(3),
        residuals=ResidualTable(_metres(answer["residual_mean_mm"]), _metres(answer["residual_max_mm"])),
        condition=answer["condition"],
        method=answer["method"],
        samples=answer["samples"],
        inlier_share=answer["inlier_share"],
        extent_m=1e-3 * answer["extent_mm"],
        scale=answer["scale"],
    )


def positioning_of(answer: JSON) -> PositioningResult:
    """Looks and steps of a look-then-move."""
    steps = tuple(
        Step(_metres(s["p_lc_mm"]), _pose(s["X_BT_ref"]), _expected_end(s["expected"]))
        for s in answer["steps"]
    )
    return PositioningResult(tuple(_verdict(look) for look in answer["looks"]), steps, Ended(answer["ended"]))


RESULT_OF: dict[str, Callable[[JSON], Any]] = {
    "look": look_of,
    "orientation-adjustment": orientation_of,
    "trajectory-matching": calibration_of,
    "look-then-move": positioning_of,
    "visit": lambda answer: positioning_of(answer["targets"][-1]),
}
"""By program; what is not here stays JSON."""


def _expected_end(answer: JSON) -> ExpectedEnd:
    """The API tells the correlation of x and y alone: z is taken for independent."""
    std = _metres(answer["std_mm"])
    covariance = np.diag(std**2)
    covariance[0, 1] = covariance[1, 0] = answer["correlation_xy"] * std[0] * std[1]
    freedom = math.inf if answer["freedom"] is None else float(answer["freedom"])
    return ExpectedEnd(_metres(answer["mean_mm"]), covariance, freedom, float(answer["inside_probability"]))


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
    """Implements the sequence's ``Rig`` over HTTP, for services on this machine: one monotonic clock.

    ``token``: of the role ``operate``, where the service wants one.
    """

    def __init__(self, url: str, token: bytes | None = None) -> None:
        self._client = (
            httpx.Client(  # the token is for the service alone, whatever proxy the environment names
                base_url=url, timeout=_TIMEOUT_S, headers=bearer(token), trust_env=False
            )
        )

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
