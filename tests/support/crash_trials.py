"""Services killed within a motion, judged by vision's REST API: the same for processes and containers."""

import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import httpx
import numpy as np

READY_S = 90.0  # of a service, and of all links, on a busy machine
HOLD_S = 1.5  # watched after everything is ready again
LEAK_MM = 20.0  # a disabled arm sinks by less in that time
MOVING_MM_S = 5.0


class Rig(NamedTuple):
    """``kill``: end that service at once. ``identities``: by service, what changes when it is started anew.
    ``serves``: whether it is ready.
    """

    face: httpx.Client
    kill: Callable[[str], None]
    identities: Callable[[], Mapping[str, object]]
    serves: Callable[[str], bool]


class CrashTrial(NamedTuple):
    """One crash. ``ready_s``: from the signal until all links are up again. ``moved_mm``: of the tool in the
    time watched after that. ``valves``: the largest command then, of 1.
    ``others_live``: the other two did not end.
    """

    service: str
    moving_mm_s: float
    ready_s: float
    moved_mm: float
    valves: float
    group_state: str
    others_live: bool
    detail: str


def until_healthy(face: httpx.Client) -> None:
    """Return once vision has pictures and a session."""
    until_s = time.monotonic() + READY_S
    while True:
        try:
            answer = face.get("/health")
            if answer.status_code == httpx.codes.OK:
                return
            said = answer.text
        except httpx.TransportError as error:
            said = str(error)
        assert time.monotonic() < until_s, said
        time.sleep(0.05)


def tool_m(face: httpx.Client) -> np.ndarray:
    """The tool's place (3,) in B, m, as encoders have it."""
    return np.array(face.get("/state").json()["X_BT"]["p_m"])


def insist(face: httpx.Client, path: str, body: Mapping[str, object] | None = None) -> None:
    """POST until it is accepted, with a reset in between: a machine just started refuses for a while."""
    until_s = time.monotonic() + READY_S
    while not (answer := face.post(path, json=body)).is_success:
        assert time.monotonic() < until_s, answer.text
        face.post("/reset")
        time.sleep(0.2)


def set_moving(face: httpx.Client, up_m: float) -> float:
    """How fast (mm/s) the tool moves, in the middle of a motion of four seconds.

    Until it moves a motion is begun again: on a busy machine a fault may end one before it is measured.
    """
    until_s = time.monotonic() + READY_S
    while True:
        insist(face, "/enable")
        insist(face, "/operations/move", {"offset_base_m": [0.0, 0.0, up_m], "duration_s": 4.0})
        time.sleep(1.5)
        first = tool_m(face)
        time.sleep(0.3)
        speed = float(1e3 * np.linalg.norm(tool_m(face) - first) / 0.3)
        if speed > MOVING_MM_S or time.monotonic() > until_s:
            return speed


def trial(rig: Rig, service: str, up_m: float) -> CrashTrial:
    """One crash of ``service`` within a motion by ``up_m``."""
    until_healthy(rig.face)
    speed, before = set_moving(rig.face, up_m), rig.identities()
    killed_s = time.monotonic()
    rig.kill(service)
    while rig.identities()[service] == before[service] or not rig.serves(service):
        assert time.monotonic() - killed_s < READY_S, "it is not started anew"
        time.sleep(0.02)
    until_healthy(rig.face)
    ready_s = time.monotonic() - killed_s
    at = tool_m(rig.face)
    time.sleep(HOLD_S)
    state = rig.face.get("/state").json()
    after = rig.identities()
    return CrashTrial(
        service=service,
        moving_mm_s=speed,
        ready_s=ready_s,
        moved_mm=float(1e3 * np.linalg.norm(np.array(state["X_BT"]["p_m"]) - at)),
        valves=max(map(abs, state["valves"])),
        group_state=state["group_state"],
        others_live=all(after[name] == before[name] for name in before if name != service),
        detail=next(
            each["detail"] for each in state["incidents"][::-1] if each["cause"] == "service.crashed"
        ),
    )


def trials(rig: Rig, service: str, count: int) -> list[CrashTrial]:
    """Several, up and down in turn."""
    return [trial(rig, service, 0.15 if number % 2 else -0.15) for number in range(count)]


def judge(one: CrashTrial) -> None:
    """The arm was moving, the service alone was started anew, and nothing moves by itself."""
    assert one.moving_mm_s > MOVING_MM_S
    assert one.others_live
    assert one.group_state in ("disabled", "error_stop")
    assert one.valves == 0.0
    assert one.moved_mm < LEAK_MM
    assert f"{one.service} crashed with signal SIGKILL" in one.detail
