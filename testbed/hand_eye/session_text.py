"""The guided dialogue as text: what each step of a session says on the terminal."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from foundation.foreign_text import parse_json
from foundation.secret_source import secret_from_file
from protocol.errors import RequestRefused
from testbed.hand_eye.importer import FORMAT
from testbed.hand_eye.pose_text import file_text
from testbed.realtime.rest_rig import RestRig
from testbed.reporting.console import bars, out, table, write_json
from vision_pc.core.hand_eye.guided import session as sessions
from vision_pc.core.perception.markers import corner_points

JSON = dict[str, Any]


def started(check: JSON, json_file: Path | None) -> None:
    """Print the verdict on the starting pose."""
    _marker(check["marker"])
    _say(f"poses in view and in bounds: {check['poses_in_view']}")
    _say(
        f"promised after {check['session']['count'].split('/')[1]} samples: "
        f"{check['promised_std_mm']:.2f} mm, {check['promised_std_deg']:.3f}° (planning noise)"
    )
    _say(check["verdict"], "green")
    write_json(json_file, check)


def proposed(proposal: JSON, json_file: Path | None) -> None:
    """Print the proposed pose."""
    x, y, z = (row[3] for row in proposal["X_BT"][:3])
    u, v = proposal["pixel"]
    _say(
        f"next pose: hand at {x:.3f} {y:.3f} {z:.3f} m; marker at pixel {u:.0f} {v:.0f}, "
        f"{proposal['distance_m']:.2f} m, {proposal['obliquity_deg']:.0f}° oblique; "
        f"adds {proposal['gain_nats']:.2f} nats, then X is known to {proposal['std_after_mm']:.2f} mm, "
        f"{proposal['std_after_deg']:.3f}° (best of {proposal['choices']})"
    )
    write_json(json_file, proposal)


def gone(done: JSON, json_file: Path | None) -> None:
    """Print where the arm stands now."""
    how = "settled" if done["settled"] else "still, beside its reference"
    _say(f"there: {how}, off by {done['off']['mm']:.2f} mm, {done['off']['deg']:.3f}°", "green")
    write_json(json_file, done)


def sampled(done: JSON, json_file: Path | None) -> None:
    """Print the new sample with its residual."""
    _marker(done["marker"])
    _say(
        f"sample {done['sample']} ({done['count']} taken): residual {_three(done['residual_mm'], 2)} mm, "
        f"{_three(done['residual_deg'], 3)}°; X known to {done['std_mm']:.2f} mm, {done['std_deg']:.3f}°",
        "green",
    )
    write_json(json_file, done)


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
    if view["proposal"] is not None:
        proposed(view["proposal"], None)
    write_json(json_file, view)


def solved(answer: JSON, json_file: Path | None) -> bool:
    """Whether the calibration is good; X, its doubt, its proof and what others say are printed."""
    p, q = answer["X_TC"]["p_m"], answer["X_TC"]["q_wxyz"]
    quaternion = " ".join(f"{v:.6f}" for v in q)
    _say(f"X_TC (camera in hand): {_three([1e3 * v for v in p], 3)} mm, q_wxyz {quaternion}")
    for what, doubt in (("samples' noise alone", answer), ("arm and the camera as well", answer["with_arm"])):
        _say(f"± by the {what}: {_three(doubt['std_mm'], 3)} mm, {_three(doubt['std_deg'], 4)}°")
    arm = answer["arm"]
    if arm is not None:
        told = ", ".join(
            f"{v:+.1f} ± {s:.1f}" for v, s in zip(arm["zeros_mrad"], arm["std_mrad"], strict=True)
        )
        _say(f"joint zeros, to be added to the encoders: {told} mrad")
    certificate = answer["certificate"]
    proof = "proven" if certificate["holds"] else "NOT proven"
    _say(f"global optimum {proof}: least eigenvalue {certificate['least_eigenvalue']:.1e}")
    rows = [
        (o["method"], o["failed"], "", "")
        if "failed" in o
        else (o["method"], _three(o["p_mm"], 2), f"{o['off']['mm']:.2f}", f"{o['off']['deg']:.3f}")
        for o in answer["others"]
    ]
    out.print(table("other methods on the same samples", ("method", "mm", "off mm", "off °"), rows))
    left_out = answer["left_out"]
    rows = [
        (r["name"], _three(r["mm"], 2), _three(r["deg"], 3), "left out" if r["name"] in left_out else "")
        for r in answer["residuals"]
    ]
    out.print(table("residuals in the camera", ("sample", "mm", "°", ""), rows))
    for note in answer["notes"]:
        _say(f"note: {note}", "yellow")
    _say(answer["verdict"], "green" if answer["good"] else "bold red")
    write_json(json_file, answer)
    return bool(answer["good"])


def located(found: JSON, json_file: Path | None) -> None:
    """Print the cabinet's targets."""
    rows = [
        (
            t["name"],
            _three(t["p_T_m"], 4),
            _three(t["p_B_m"], 4),
            f"{t['correlation']:.3f}",
            f"{t['gap_px']:.3f}",
        )
        for t in found["targets"]
    ]
    columns = ("target", "in the hand m", "in the base m", "correlation", "gap px")
    out.print(table("control cabinet", columns, rows))
    write_json(json_file, found)


def named(names: Sequence[str]) -> None:
    """Print the sessions on the vision PC's disk."""
    _say(", ".join(names) or "no sessions")


def exported(session: Path, samples: Path) -> None:
    """Write the samples of a session's file to ``samples``, in the importer's format.

    Raises RequestRefused (``refused.hand_eye.format``).
    """
    try:
        document = parse_json(file_text(session))
        if document["format"] not in (sessions.FORMAT, sessions.FORMAT_1):
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
        names: list[str] = self._ask("GET", "/hand-eye/sessions")["names"]
        return names

    def resume(self, name: str) -> JSON:
        """A session from the disk, opened."""
        return self._ask("POST", "/hand-eye/session/resume", json={"name": name})

    def propose(self, informative: bool = True) -> JSON:
        """The next pose."""
        return self._ask("POST", "/hand-eye/session/propose", json={"informative": informative})

    def remove(self, name: str) -> JSON:
        """The session without a sample."""
        return self._ask("DELETE", f"/hand-eye/session/samples/{name}")


def with_session(url: str, token_file: Path | None, act: Callable[[SessionClient], None]) -> None:
    """Call ``act`` with a connection to the vision PC at ``url``, and close it.

    ``token_file``: where the token of the role ``operate`` is, if one is wanted. Raises ConfigurationError as
    ``secret_from_file`` does.
    """
    face = SessionClient(url, None if token_file is None else secret_from_file(token_file, "operate token"))
    try:
        act(face)
    finally:
        face.close()
