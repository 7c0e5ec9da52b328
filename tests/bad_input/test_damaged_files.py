"""Every command that reads files, over good ones that were damaged, and with output that cannot be written.

None ends with a traceback or takes 10 s; damage is told in one line, with a status; what is to be written is
whole or not there.
"""

import json
import os
import random
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from mcap.writer import Writer
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from testbed.cli.main import app
from tests.support.paths import CONFIGS, ROOT

pytestmark = pytest.mark.slow("hundreds of damaged files")
WITHIN_S = 10.0
SIDE = 160


def recording() -> bytes:
    """A recording of two topics in JSON."""
    path = Path("recording.mcap")
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("Any", "jsonschema", b'{"type": "object"}')
        for topic in ("/arm/state", "/\x1b[31mred\x1b[0m"):
            channel = writer.register_channel(topic, "json", schema)
            for k in range(20):
                writer.add_message(channel, 1000 + k, json.dumps({"k": k, "x": 0.5 * k}).encode(), 1000 + k)
        writer.finish()
    return path.read_bytes()


def picture(shift: int = 0) -> bytes:
    """A marker on paper, PNG."""
    grey = np.full((SIDE, SIDE + 40), 210, np.uint8)
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000)
    grey[40:120, 40 + shift : 120 + shift] = cv2.aruco.generateImageMarker(book, 3, 80)
    return cv2.imencode(".png", cv2.GaussianBlur(grey, (0, 0), 0.7))[1].tobytes()


def samples() -> list[dict[str, object]]:
    """Hand and target, looked at from eight sides."""
    rng = np.random.default_rng(4)
    X, Z = np.eye(4), np.eye(4)
    X[:3, 3], Z[:3, 3] = (0.05, 0.02, 0.1), (0.9, 0.0, 0.0)
    found = []
    for k in range(8):
        hand = np.eye(4)
        turn = np.add((180.0, 0.0, 0.0), rng.uniform(-30.0, 30.0, 3))
        hand[:3, :3] = Rotation.from_euler("xyz", turn, degrees=True).as_matrix()
        hand[:3, 3] = np.add((0.7, 0.0, 0.8), rng.uniform(-0.1, 0.1, 3))
        camera = np.linalg.inv(hand @ X) @ Z
        found.append({"name": f"s{k}", "hand": hand.tolist(), "camera": camera.tolist()})
    return found


def tum(side: str) -> bytes:
    """The same as a recording of one side."""
    rows = []
    for k, sample in enumerate(samples()):
        pose = np.array(sample[side])
        turn = Rotation.from_matrix(pose[:3, :3]).as_quat()
        rows.append(" ".join(f"{number:.9f}" for number in (100.0 + k, *pose[:3, 3], *turn)))
    return "\n".join(rows).encode()


def poses() -> bytes:
    """The hand's side without times."""
    return b"\n".join(line.partition(b" ")[2] for line in tum("hand").splitlines()[:1])


DOCUMENT = {"format": "longreach-hand-eye/1", "setup": "eye-in-hand", "length_unit": "m"}
CALIBRATION = b"fx_px: 150.0\nfy_px: 150.0\ncx_px: 99.5\ncy_px: 79.5\nbaseline_m: 0.12\n"
INTRINSICS = {"camera_matrix": [[150.0, 0, 99.5], [0, 150.0, 79.5], [0, 0, 1]], "distortion": [0.0] * 5}
CAMERA_INFO = """image_width: 200
image_height: 160
camera_name: left
camera_matrix: {rows: 3, cols: 3, data: [150.0, 0, 99.5, 0, 150.0, 79.5, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.01, 0, 0, 0, 0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [150.0, 0, 99.5, SHIFT, 0, 150.0, 79.5, 0, 0, 0, 1, 0]}
"""


def info(shift: str) -> bytes:
    """One eye's ``camera_info``; ``shift`` is the fourth number of P."""
    return CAMERA_INFO.replace("SHIFT", shift).encode()


class Reading(NamedTuple):
    """A command, the good files that it reads (the first is damaged), and what it writes.

    ``good``: its status with the good ones.
    """

    words: str
    files: dict[str, Callable[[], bytes]]
    writes: str = ""
    good: int = 0


def bytes_of(document: object) -> Callable[[], bytes]:
    return lambda: json.dumps(document).encode()


MCAP = {"a.mcap": recording}
EYES = {
    f"{eye}/{k}.png": partial(picture, k + shift)
    for eye, shift in (("left", 4), ("right", 0))
    for k in (1, 2)
}
SAMPLES = bytes_of({**DOCUMENT, "samples": samples()})
SIDES = {"hand.tum": partial(tum, "hand"), "camera.tum": partial(tum, "camera")}
PICTURED = {"poses.txt": poses, "camera.json": bytes_of(INTRINSICS), "eyes/1.png": picture}
SAMPLED = "hand-eye samples eyes poses.txt --camera camera.json --out s.json"
INFOS = {"a.yaml": partial(info, "0"), "b.yaml": partial(info, "-18.0")}
PAIRED = {"c.yaml": lambda: CALIBRATION, **EYES}
FOLLOWED = "odometry --left left --right right --calib c.yaml --out t.tum"


def configured(name: str) -> dict[str, Callable[[], bytes]]:
    return {f"c/{name}.yaml": (CONFIGS / f"{name}.yaml").read_bytes}


COMMANDS = (
    Reading("recording info a.mcap", MCAP),
    Reading("replay a.mcap", MCAP, good=2),
    Reading("markers a.png", {"a.png": picture}),
    Reading("hand-eye intrinsics a.png", {"a.png": picture}, good=2),
    Reading("hand-eye solve a.json", {"a.json": SAMPLES}),
    Reading("hand-eye solve a.yaml", {"a.yaml": SAMPLES}),
    Reading("hand-eye solve hand.tum camera.tum", SIDES),
    Reading("hand-eye compare a.json", {"a.json": SAMPLES}),
    Reading(SAMPLED, PICTURED, "s.json", good=2),
    Reading(SAMPLED, {"camera.json": PICTURED["camera.json"], **PICTURED}, "s.json", good=2),
    Reading("hand-eye session export a.json --out s.json", {"a.json": SAMPLES}, "s.json", good=2),
    Reading("camera convert a.yaml b.yaml --out c.yaml", INFOS, "c.yaml"),
    Reading("camera check eyes", {"eyes/left.png": picture, "eyes/right.png": picture}, good=2),
    Reading(FOLLOWED, PAIRED, "t.tum"),
    Reading(FOLLOWED, {"left/1.png": EYES["left/1.png"], **PAIRED}, "t.tum"),
    Reading("arm check --config-dir c", configured("arm")),
    Reading("export urdf --config-dir c --out a.urdf", configured("arm"), "a.urdf"),
    Reading("arm draw --config-dir c --out a.png", configured("plant"), "a.png"),
)
NO_FILE = ("empty", "noise", "nested", "directory", "absent")  # of any kind
GONE = ("absent",)
OTHER = ("NaN", "1e300", "9" * 5000, "[]", '"x"', "null", "2026-13-45", "-1")  # in place of a number
TOLERATED = {  # what is left out is said, and the rest is done
    "odometry": (*GONE, "nested"),
}


def damaged(good: bytes, how: str, rng: random.Random) -> bytes:
    """``good`` spoiled; where there is no text, or no number in it, by a few bits."""
    if how == "empty":
        return b""
    if how == "noise":
        return rng.randbytes(300)
    if how == "nested":
        return b"[" * 100_000
    if how == "cut":
        return good[: rng.randrange(len(good))]
    if how == "UTF-16":
        return good.decode("latin-1").encode("utf-16")
    if how == "letter":
        at = rng.randrange(len(good))
        return good[:at] + b"\xe9\x1b" + good[at:]
    numbers = [*re.finditer(rb"-?\d+(\.\d+)?", good)] if b"\0" not in good else []
    if how == "number" and numbers:
        place = rng.choice(numbers)
        return good[: place.start()] + rng.choice(OTHER).encode() + good[place.end() :]
    spoiled = bytearray(good)
    for _ in range(rng.choice((1, 3, 20))):
        spoiled[rng.randrange(len(good))] ^= 1 << rng.randrange(8)
    return bytes(spoiled)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "configs").symlink_to(CONFIGS)
    return tmp_path


def laid_out(case: Reading) -> Path:
    """The good files of ``case`` in the working directory; the one that is to be damaged."""
    if "--config-dir c" in case.words:
        shutil.copytree(CONFIGS, "c", dirs_exist_ok=True)
    for name, content in case.files.items():
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_bytes(content())
    first = Path(next(iter(case.files)))
    first.chmod(0o600)
    return first


@pytest.mark.parametrize("case", COMMANDS, ids=lambda case: f"{case.words[:30]} {next(iter(case.files))}")
def test_damage_is_one_line_and_a_status_and_leaves_nothing_half_made(case: Reading, here: Path) -> None:
    file = laid_out(case)
    done = CliRunner().invoke(app, case.words.split())
    assert done.exit_code == case.good, done.output
    assert Path(case.writes).exists() or case.good == 2, done.output
    rng, good = random.Random(case.words), file.read_bytes()
    for how in (*NO_FILE, "cut", "UTF-16", "letter", *["number"] * 3, *["bits"] * 2):
        for made in filter(None, (case.writes, "t.csv")):
            shutil.rmtree(made, ignore_errors=True)
            Path(made).unlink(missing_ok=True)
        shutil.rmtree(file) if file.is_dir() else file.unlink(missing_ok=True)
        spoiled = damaged(good, how, rng)
        if how == "directory":
            file.mkdir()
        elif how != "absent":
            file.write_bytes(spoiled)
            file.chmod(0o600)
        began_s = time.monotonic()
        done = CliRunner().invoke(app, case.words.split())
        what = f"{how}: {spoiled[:200]!r}\n{done.output}"
        assert done.exception is None or isinstance(done.exception, SystemExit), what
        assert time.monotonic() - began_s < WITHIN_S, what
        assert "\x1b" not in done.output, what
        if done.exit_code == 2:
            assert re.fullmatch(r"longreach: [a-z_]+(\.[a-z_]+)+: [^\n]+\n", done.stderr), what
            assert not case.writes or not Path(case.writes).exists(), what
        if how in NO_FILE and how not in TOLERATED.get(case.words.split()[0], ()):
            assert done.exit_code != 0, what


@pytest.mark.parametrize(
    ("command", "made"),
    [
        ("export urdf --out {}/a.urdf", "a.urdf"),
        ("arm draw --out {}/a.png", "a.png"),
        ("target --marker 582 --size-mm 50 --out {}/a.pdf", "a.pdf"),
        ("arm new {}/arm", "arm"),
        ("init {}/configs", "configs"),
    ],
)
def test_what_does_not_fit_on_the_disk_is_not_there(
    command: str, made: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every file is cut at 100 bytes, as by a full disk."""
    recording()
    Path("runs/20260101-000000").mkdir(parents=True)
    script = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100)); sys.dont_write_bytecode = True;"
        "from testbed.cli.main import app; app()"
    )
    Path("full").mkdir()
    words = [sys.executable, "-c", script, *command.format("full").split()]
    done = subprocess.run(words, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert done.returncode == 2, done.stderr
    assert re.fullmatch(r"longreach: [a-z]+\.[a-z_]+: [^\n]+\n", done.stderr)
    assert not (Path("full") / made).exists()
