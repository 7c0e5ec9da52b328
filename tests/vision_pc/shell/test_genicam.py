"""GigE Vision end to end: Aravis' own cameras on two addresses of a network namespace."""

import ctypes.util
import json
import shutil
import subprocess
import sys
from typing import Any

import pytest

from tests.support.paths import ROOT

TRIAL = (
    "ip link set lo up && ip addr add 127.0.0.2/8 dev lo && exec {} -m tests.vision_pc.shell.gige_trial {}"
)
SHARED = (
    "vision.camera.genicam.trigger=free",
    "vision.camera.genicam.frame_rate_hz=40",
    "vision.camera.genicam.clock=host",
)


def _possible() -> str:
    """Why the trial cannot be made here, else nothing."""
    if ctypes.util.find_library("aravis-0.8") is None:
        return "Aravis is absent: make foreign-tools"
    if shutil.which("unshare") is None or shutil.which("ip") is None:
        return "unshare or ip is absent"
    tried = subprocess.run(
        ["unshare", "-Urn", "ip", "link", "set", "lo", "up"], capture_output=True, check=False
    )
    return "" if tried.returncode == 0 else "no network namespace may be made here"


pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(bool(_possible()), reason=_possible() or "possible"),
]


def trial(*overrides: str) -> dict[str, Any]:
    command = TRIAL.format(sys.executable, " ".join(overrides))
    done = subprocess.run(
        ["unshare", "-Urn", "sh", "-c", command],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    said: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return said


@pytest.mark.slow("pictures over a second, a camera unplugged and back")
def test_pairs_come_right_and_an_unplugged_camera_is_named_and_comes_back() -> None:
    said = trial(*SHARED)
    assert len(said["pairs"]) > 10
    assert all(right - left == 100 for left, right, _ in said["pairs"])
    ages_ms = sorted(age / 1e6 for _, _, age in said["pairs"])
    assert 0.0 <= ages_ms[0] < 50.0
    assert said["reports"][-2] in ("link.camera_silent", "link.camera_missing")
    assert said["reports"][-1] is True, said


@pytest.mark.parametrize(
    ("wrong", "cause"),
    [
        ("vision.camera.genicam.trigger=Line9", "link.camera_refused"),
        ("vision.camera.genicam.pixel_format=Coord3D_ABC32f", "link.camera_refused"),
        ("vision.camera.genicam.right=127.0.0.3", "link.camera_missing"),
    ],
)
def test_what_a_camera_does_not_take_is_named(wrong: str, cause: str) -> None:
    said = trial(*SHARED, "vision.camera.stale_ms=8000", wrong)
    assert said["pairs"] == []
    assert said["reports"][0].startswith(cause), said
    assert wrong.split("=")[1] in said["reports"][0]
