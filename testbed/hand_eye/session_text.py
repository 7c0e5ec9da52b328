"""The guided dialogue as text: what each step of a session says on the terminal."""

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from foundation.foreign_text import parse_json
from foundation.secret_source import secret_from_file
from protocol.errors import RequestRefused
from testbed.hand_eye.importer import FORMAT
from testbed.hand_eye.pose_text import file_text
from testbed.realtime.rest_rig import RestRig
from testbed.reporting.console import bars, noted, out, table, write_json
from vision_pc.core.hand_eye.guided import session as sessions
from vision_pc.core.perception.markers import corner_points

JSON = dict[str, Any]
T = TypeVar("T")


def started(check: JSON) -> None:
    """Print the verdict on the starting pose."""
    _marker(check["marker"])
    _say(f"poses in view and in bounds: {check['poses_in_view']}")
    _say(check["verdict"], "green")


def sampled(done: JSON) -> None:
    """Print the new sample with its residual."""
    _marker(done["marker"])
    _say(
        f"sample {done['sample']} ({done['count']} taken): residual {_three(done['residual_mm'], 2)} mm, "
        f"{_three(done['residual_deg'], 3)}°; X known to {done['std_mm']:.2f} mm, {done['std_deg']:.3f}°",
        "green",
    )


def listed(view: JSON, json_file: Path | None) -> None:
    """Print the session."""
    rows = [
        (s["name"], f"{s['distance_m']:.2f}", _three(s["residual_mm"], 2), _three(s["residual_deg"], 3),
         "settled" if s["settled"] else "still")
        for s in view["samples"]
    ]  # fmt: skip
    title = f"session {view['name']}: {view['count']} samples of marker {view['marker_id']}"
    out.print(table(title, ("sample", "m away", "residual mm", "residual °", "arm"), rows))
    if view["refused"]:
        _say(f"the controller refused {view['refused']} poses")
    write_json(json_file, view)


def solved(answer: JSON, json_file: Path | None) -> bool:
    """Whether the calibration is good; X, its doubt and its proof are printed."""
    p, q = answer["X_TC"]["p_m"], answer["X_TC"]["q_wxyz"]
    quaternion = " ".join(f"{v:.6f}" for v in q)
    _say(f"X_TC (camera in hand): {_three([1e3 * v for v in p], 3)} mm, q_wxyz {quaternion}")
    for what, doubt in (("samples' noise alone", answer), ("arm and the camera as well", answer["with_arm"])):
        _say(f"± by the {what}: {_three(doubt['std_mm'], 3)} mm, {_three(doubt['std_deg'], 4)}°")
    arm = answer["arm"]
    zeros = ", ".join(f"{v:+.1f} ± {s:.1f}" for v, s in zip(arm["zeros_mrad"], arm["std_mrad"], strict=True))
    _say(f"joint zeros, to be added to the encoders: {zeros} mrad")
    proof = "proven" if answer["certificate"]["holds"] else "NOT proven"
    _say(f"global optimum {proof}: least eigenvalue {answer['certificate']['least_eigenvalue']:.1e}")
    rows = [
        (
            r["name"],
            _three(r["mm"], 2),
            _three(r["deg"], 3),
            "left out" if r["name"] in answer["left_out"] else "",
        )
        for r in answer["residuals"]
    ]
    out.print(table("residuals in the camera", ("sample", "mm", "°", ""), rows))
    noted(f"note: {note}" for note in answer["notes"])
    _say(answer["verdict"], "green" if answer["good"] else "bold red")
    write_json(json_file, answer)
    return bool(answer["good"])


def exported(session: Path, samples: Path) -> None:
    """Write the samples of a session's file to ``samples``, in the importer's format.

    Raises RequestRefused (``refused.hand_eye.format``).
    """
    try:
        document = parse_json(file_text(session))
        if document["format"] != sessions.FORMAT:
            raise ValueError(f"format is {document['format']!r}, {sessions.FORMAT!r} is wanted")
        exported_document = {
            "format": FORMAT,
            "setup": "eye-in-hand",
            "length_unit": "m",
            "marker_id": document["settings"]["marker_id"],
            "samples": [
                {key: s[key] for key in ("name", "hand", "camera", "marker_id", "corners_px")}
                for s in document["samples"]
            ],
            "target_points_m": corner_points(document["settings"]["marker_size_m"]).tolist(),
            "camera_matrix": document["camera"]["K"],
            "distortion": document["camera"]["distortion"],
        }
    except (ValueError, KeyError, TypeError) as error:
        raise RequestRefused("refused.hand_eye.format", f"{session.name}: {error}") from error
    write_json(samples, exported_document)


def _marker(marker: JSON) -> None:
    _say(
        f"marker seen in {marker['seen']} pictures, {marker['distance_m']:.3f} m away, "
        f"{marker['obliquity_deg']:.0f}° oblique; ±{_three(marker['std_mm'], 2)} mm, "
        f"±{_three(marker['std_deg'], 3)}°"
    )


def _three(values: Sequence[float], digits: int) -> str:
    return " ".join(f"{value:.{digits}f}" for value in values)


def _say(text: str, style: str | None = None) -> None:
    out.print(text, style=style, highlight=False, soft_wrap=True)


class SessionClient(RestRig):
    """Commands of the session; each raises what the problem document says."""

    def step(self, kind: str, body: JSON, what: str) -> JSON:
        """The result of operation ``hand-eye-<kind>``, with its progress shown."""
        with bars() as shown, shown.step(what) as bar:
            return self.result(f"hand-eye-{kind}", body, bar)

    def view(self) -> JSON:
        """The open session."""
        return self._ask("GET", "/hand-eye/session")

    def names(self) -> list[str]:
        """The sessions on the vision PC's disk."""
        return list(self._ask("GET", "/hand-eye/sessions")["names"])

    def resume(self, name: str) -> JSON:
        """A session from the disk, opened."""
        return self._ask("POST", "/hand-eye/session/resume", json={"name": name})

    def remove(self, name: str) -> JSON:
        """The session without a sample."""
        return self._ask("DELETE", f"/hand-eye/session/samples/{name}")


def run_session(client: SessionClient, body: JSON, json_file: Path | None) -> bool:
    """Whether the session that ``body`` names is solved well; it is begun, or goes on."""
    if body["name"] in client.names():
        view = client.resume(body["name"])
    else:
        given = {key: value for key, value in body.items() if value is not None}
        started(client.step("start", given, "checking the starting pose"))
        view = client.view()
    while not view["complete"]:
        if view["samples"]:
            client.step("next", {}, "moving to the next pose")
        sampled(client.step("sample", {}, "taking a sample"))
        view = client.view()
    listed(view, None)
    return solved(client.step("solve", {}, "solving"), json_file)


def with_session(url: str, token_file: Path | None, act: Callable[[SessionClient], T]) -> T:
    """What ``act`` returns of a connection to the vision PC at ``url``, which is closed then.

    ``token_file``: where the token of the role ``operate`` is, if one is wanted. Raises ConfigurationError as
    ``secret_from_file`` does.
    """
    token = None if token_file is None else secret_from_file(token_file, "operate token")
    with contextlib.closing(SessionClient(url, token)) as client:
        return act(client)
