"""Rendered sequences for odometry: a camera before a wall, what makes it hard, and where it truly was.

The wall, what stands or passes before it, light, shutter and rectification are the emulated camera's own.
Every sequence has a drawn way, wall, and what factory calibrations leave of rectification.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from foundation.configuration import load
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.exposures import CameraView, Capture, Shot, motion_between
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.faults.kinds import CameraBlind
from vision_pc.config.vision import RectifiedPairSettings
from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.core.types import StereoPair

JSON = dict[str, Any]

RATE_HZ = 10.0
WIDTH, HEIGHT, FOCAL_PX, BASELINE_M = 1280, 720, 530.0, 0.12  # a ZED2's, 720p
ROWS_PX, DISPARITY_PX = 0.25, 0.52  # [S] what factory calibrations of a ZED leave, at most
_LEGS = np.array([[0.5, 0.0, 0.0], [0.25, 0.25, 0.0], [0.1, -0.1, 0.2]])  # m, along the camera's axes
_TURNS_DEG = (2.0, 3.0, 2.0)
_BEHIND = se3.transform(np.eye(3), (0.0, 0.0, -5.0))  # the tool: out of sight
_BLIND = CameraBlind(grey=0)
_MIDDLE_S = 2.0  # when what moves is in the middle of the picture
_STRAIN, _BENT_RAD_M = 4e-3, 2e-3  # [E] of the rigid model: of the way, and rad a metre
_SWING_M, _STATE_NOISE_M = 3e-3, 2e-4  # [E] booms that swing; the encoders' steps
_ASIDE_M = 0.35  # the camera's own way, and its turn: what comes late is out of sight before


class DrawnWay(NamedTuple):
    """What the seed drew: the way, the wall's distance and the right eye's offset as it truly is."""

    X_C0C: Array
    distance_m: float
    disparity_px: float
    rows_px: float


class Sequence(NamedTuple):
    """Rendered ``pairs``, where the left eye truly was (n, 4, 4), and the calibration that is believed.

    ``arm``: X_BT by the pair's number, what the state of an arm that carries the camera says of its tool.
    """

    pairs: list[StereoPair]
    X_C0C: Array
    stated: RectifiedPairSettings
    arm: dict[int, Array] = {}  # noqa: RUF012


class SequenceKind(NamedTuple):
    """One kind: what it is in ``words``, overrides of the scene, pairs that are black or left out, what is
    done to the pictures, and whether the calibration is exact and known to be (``exact``) or of another size.

    ``refused``: nothing but a refusal by name is right. ``arm``: the state of an arm is told as well.
    """

    words: str
    scene: Callable[[DrawnWay, np.random.Generator], JSON] = lambda drawn, rng: {}
    black: int = 0
    left_out: int = 0
    spoil: Callable[[StereoPair], StereoPair] = lambda pair: pair
    exact: bool = False
    rows_px: float | None = None
    another_size: bool = False
    refused: bool = False
    arm: bool = False


def _blocks(drawn: DrawnWay, rng: np.random.Generator) -> JSON:
    blocks = [
        {
            "centre_m": [float(x), float(rng.uniform(-0.6, 0.6))],
            "size_m": [float(rng.uniform(0.2, 0.5)), float(rng.uniform(0.2, 0.5))],
            "depth_m": float(rng.uniform(0.1, 0.5)),
            "texture_seed": int(rng.integers(1 << 30)),
        }
        for x in (-1.2, -0.6, 0.0, 0.6, 1.2)
    ]
    return {"wall": {"blocks": blocks}}


def _bare(drawn: DrawnWay, rng: np.random.Generator) -> JSON:
    patches = [
        {"centre_m": [float(x), float(y)], "radius_m": float(rng.uniform(0.35, 0.55)), "contrast": 0.05}
        for x in (-1.6, -0.6, 0.5, 1.5)
        for y in rng.uniform(-0.7, 0.7, 2)
    ]
    return {"wall": {"bare_patches": patches}}


def _mover(share: float) -> Callable[[DrawnWay, np.random.Generator], JSON]:
    """A textured board that hides a ``share`` of the width in the middle of the sequence: it comes in, or
    (half of the seeds) is slower and there from the first picture on.
    """

    def scene(drawn: DrawnWay, rng: np.random.Generator) -> JSON:
        stand_off, whole = _before_the_wall(drawn, rng)
        comes = 0.5 * (1.0 + share) * whole / _MIDDLE_S  # m/s: outside of the first picture
        speed = comes * (1.0 if rng.random() < 0.5 else rng.uniform(0.05, 0.5))
        return _passer(drawn, rng, (share * whole, stand_off), speed, _MIDDLE_S)

    return scene


def _late(share: float) -> Callable[[DrawnWay, np.random.Generator], JSON]:
    """A board that is out of sight until a third of the sequence and more is over, and then comes in."""

    def scene(drawn: DrawnWay, rng: np.random.Generator) -> JSON:
        stand_off, whole = _before_the_wall(drawn, rng)
        lasts_s = len(drawn.X_C0C) / RATE_HZ
        enters_s, middle_s = lasts_s * rng.uniform(0.33, 0.45), lasts_s * rng.uniform(0.6, 0.75)
        way = 0.5 * (1.0 + share) * whole + _ASIDE_M  # from the edge to the middle of the picture
        return _passer(drawn, rng, (share * whole, stand_off), way / (middle_s - enters_s), middle_s)

    return scene


def _slow(drawn: DrawnWay, rng: np.random.Generator) -> JSON:
    """A board that is there from the first picture on and goes by a few mm from picture to picture."""
    stand_off, whole = _before_the_wall(drawn, rng)
    width = rng.uniform(0.15, 0.4) * whole
    return _passer(drawn, rng, (width, stand_off), rng.uniform(0.01, 0.05), _MIDDLE_S)


def _before_the_wall(drawn: DrawnWay, rng: np.random.Generator) -> tuple[float, float]:
    """How far before the wall something moves, and how wide the picture is there, m."""
    stand_off = float(rng.uniform(0.25, 0.5) * drawn.distance_m)
    return stand_off, (drawn.distance_m - stand_off) * WIDTH / FOCAL_PX


def _passer(
    drawn: DrawnWay, rng: np.random.Generator, size: tuple[float, float], speed: float, middle_s: float
) -> JSON:
    """A board, ``size`` its width and how far it is before the wall, that is in the middle of the picture at
    ``middle_s``.
    """
    velocity = float(rng.choice([-1.0, 1.0])) * float(speed)
    rise = float(rng.uniform(-0.05, 0.05))
    at = min(round(middle_s * RATE_HZ), len(drawn.X_C0C) - 1)
    there = drawn.X_C0C[at, :2, 3] * (1.0, -1.0)
    passer = {
        "size_m": [float(size[0]), 5.0],
        "start_m": [float(there[0]) - middle_s * velocity, float(there[1]), size[1]],
        "velocity_m_s": [velocity, rise, 0.0],
        "period_s": 600.0,
        "texture_seed": int(rng.integers(1 << 30)),
        "contrast_grey": 22.0,
    }
    return {"passers": [passer]}


def _camera(**settings: Any) -> Callable[[DrawnWay, np.random.Generator], JSON]:
    return lambda drawn, rng: {"camera": settings}


def _swap_eyes(pair: StereoPair) -> StereoPair:
    return pair._replace(left=pair.right, right=pair.left)


KINDS: dict[str, SequenceKind] = {
    "still_wall": SequenceKind("still wall, calibration exact and known to be", exact=True),
    "wall": SequenceKind("still wall"),
    "depth_steps": SequenceKind("depth steps of 0.1 to 0.5 m", _blocks),
    "bare_patches": SequenceKind("bare patches over half of the wall", _bare),
    "mover_10": SequenceKind("a thing moves over 10 % of the picture", _mover(0.1)),
    "mover_30": SequenceKind("over 30 %", _mover(0.3)),
    "mover_60": SequenceKind("over 60 %", _mover(0.6)),
    "mover_80": SequenceKind("over 80 %", _mover(0.8)),
    "late_10": SequenceKind("it comes late, over 10 %", _late(0.1)),
    "late_30": SequenceKind("late, over 30 %", _late(0.3)),
    "late_60": SequenceKind("late, over 60 %", _late(0.6)),
    "late_80": SequenceKind("late, over 80 %", _late(0.8)),
    "slow_mover": SequenceKind("a slow thing, 10 to 50 mm/s", _slow),
    "darkness": SequenceKind("6 % of the light", _camera(exposure_gain=0.06, noise_grey=1.5)),
    "blur": SequenceKind("exposures of 80 ms in motion", _camera(exposure_us=80_000, motion_blur_samples=6)),
    "gap_1": SequenceKind("1 black pair", black=1),
    "gap_2": SequenceKind("2 black pairs", black=2),
    "gap_5": SequenceKind("5 black pairs", black=5),
    "gap_10": SequenceKind("10 black pairs", black=10),
    "gap_20": SequenceKind("20 black pairs", black=20),
    "left_out_1": SequenceKind("1 pair missing", left_out=1),
    "left_out_2": SequenceKind("2 pairs missing", left_out=2),
    "left_out_5": SequenceKind("5 pairs missing", left_out=5),
    "left_out_10": SequenceKind("10 pairs missing", left_out=10),
    "left_out_20": SequenceKind("20 pairs missing", left_out=20),
    "rows_0.3": SequenceKind("right picture 0.3 px lower", rows_px=0.3),
    "rows_3": SequenceKind("right picture 3 px lower", rows_px=3.0, refused=True),
    "rolling": SequenceKind(
        "rolling shutter, 37 ms", _camera(shutter={"kind": "rolling", "mode_hz": 15}), refused=True
    ),
    "swapped": SequenceKind("eyes swapped", spoil=_swap_eyes, refused=True),
    "another_size": SequenceKind("calibration of another size", another_size=True, refused=True),
}
_WITH_ARM = (
    "wall",
    "mover_10",
    "mover_30",
    "mover_60",
    "late_10",
    "late_30",
    "late_60",
    "slow_mover",
)
KINDS |= {
    f"{name}_arm": KINDS[name]._replace(words=f"{KINDS[name].words}; arm's state told", arm=True)
    for name in _WITH_ARM
}
_SIZES = ((672, 376), (1920, 1080), (2208, 1242))  # a ZED's other ones


def sequence(config_dir: Any, name: str, seed: int, count: int) -> Sequence:
    """``count`` pairs of kind ``name``, as ``seed`` draws them."""
    kind, rng = KINDS[name], np.random.default_rng((0x0D0, seed, crc32(name.encode())))
    gone = kind.left_out
    drawn = _draw_path(kind, rng, count + gone)
    config = load(SceneConfig, config_dir / "scene.yaml", _overrides(kind, drawn, rng, seed))
    scene = Scene(config)
    camera = StereoCamera(config.camera, scene, seed)
    kept = [k for k in range(count + gone) if not count // 2 <= k < count // 2 + gone]
    pairs = list(_render(kind, camera, scene, drawn, kept))
    stated = _stated_camera(kind, rng)
    X_BT = _state(drawn.X_C0C, rng)
    arm = {number: X_BT[k] for number, k in enumerate(kept)} if kind.arm else {}
    return Sequence(pairs, drawn.X_C0C[kept], stated, arm)


def _state(X_C0C: Array, rng: np.random.Generator) -> Array:
    """X_BT (n, 4, 4) of an arm that carries the camera at ``X_C0C``, by its own rigid model: it bends by some
    millimetres a metre, its booms swing, and camera and tool are about half a metre apart, turned anyhow.
    """
    tool = se3.transform(se3.exp_so3(rng.normal(0.0, 1.0, 3)), rng.uniform(-0.4, 0.4, 3))
    base = se3.transform(se3.exp_so3(rng.normal(0.0, 1.0, 3)), rng.uniform(-3.0, 3.0, 3))
    strain, bent = rng.normal(0.0, _STRAIN, (3, 3)), rng.normal(0.0, _BENT_RAD_M, (3, 3))
    swing, hz, phase = rng.uniform(0.0, _SWING_M) * _unit(rng), rng.uniform(0.6, 2.0), rng.uniform(0.0, 6.3)
    found = []
    for k, X in enumerate(X_C0C):
        place = X[:3, 3] + strain @ X[:3, 3] + swing * np.sin(2.0 * np.pi * hz * k / RATE_HZ + phase)
        place = place + rng.normal(0.0, _STATE_NOISE_M, 3)
        turn = se3.exp_so3(bent @ X[:3, 3]) @ X[:3, :3]
        found.append(base @ se3.transform(turn, place) @ tool)
    return np.stack(found)


def _unit(rng: np.random.Generator) -> Array:
    direction = rng.normal(0.0, 1.0, 3)
    return np.asarray(direction / np.linalg.norm(direction))


def _draw_path(kind: SequenceKind, rng: np.random.Generator, count: int) -> DrawnWay:
    turn = se3.exp_so3([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    legs = _LEGS * rng.uniform(0.7, 1.2, (3, 1)) * (1.0, rng.choice([-1.0, 1.0]), rng.choice([-1.0, 1.0]))
    swings = np.radians(_TURNS_DEG) * rng.choice([-1.0, 1.0], 3)
    disparity, rows = rng.uniform(-1.0, 1.0, 2) * (DISPARITY_PX, ROWS_PX)
    if kind.exact:
        disparity = rows = 0.0
    rows = rows if kind.rows_px is None else kind.rows_px
    return DrawnWay(
        _way(legs @ turn.T, swings, count), float(rng.uniform(1.2, 2.0)), float(disparity), float(rows)
    )


def _way(legs: Array, swings: Array, count: int) -> Array:
    """X_C0C (count, 4, 4): along the legs, at rest at their ends, turning by a few degrees."""
    corners = np.vstack([np.zeros(3), np.cumsum(legs, axis=0)])
    found = []
    for u in np.linspace(0.0, len(legs), count):
        leg = min(int(u), len(legs) - 1)
        f = u - leg
        place = corners[leg] + legs[leg] * (10 * f**3 - 15 * f**4 + 6 * f**5)
        turn = swings * (np.sin(u), np.sin(0.7 * u), u / 2.0)
        found.append(se3.transform(se3.exp_so3(turn), place))
    return np.stack(found)


def _overrides(kind: SequenceKind, drawn: DrawnWay, rng: np.random.Generator, seed: int) -> JSON:
    """Of scene.yaml: the believed camera but for what rectification leaves, and no markers."""
    lens = {"fx_px": FOCAL_PX, "fy_px": FOCAL_PX, "cx_px": (WIDTH - 1) / 2, "cy_px": (HEIGHT - 1) / 2}
    asked = kind.scene(drawn, rng)
    camera: JSON = {
        "baseline_m": BASELINE_M,
        "lens": lens | dict.fromkeys(("k1", "k2", "p1", "p2", "k3"), 0.0),
        "rectification": {
            "disparity_px": drawn.disparity_px,
            "vertical_px": drawn.rows_px,
            "right_eye_rotation_deg": [0.0, 0.0, 0.0 if kind.exact else float(rng.normal(0.0, 0.01))],
        },
    }
    return asked | {
        "wall": {"texture_seed": 7000 + seed} | asked.get("wall", {}),
        "object_of_interest": {"markers": []},
        "camera": camera | asked.get("camera", {}),
    }


def _render(
    kind: SequenceKind, camera: StereoCamera, scene: Scene, drawn: DrawnWay, kept: list[int]
) -> Iterator[StereoPair]:
    facing = se3.transform(np.diag([1.0, -1.0, -1.0]) @ se3.exp_so3(np.radians([4.0, -6.0, 2.0])), (0, 0, 0))
    facing[2, 3] = drawn.distance_m
    views = [CameraView(X := scene.mounts.X_WO @ facing @ X_C0C, X @ _BEHIND) for X_C0C in drawn.X_C0C]
    first = len(kept) // 2
    for number, k in enumerate(kept):
        before, after = max(k - 1, 0), min(k + 1, len(views) - 1)
        motion = motion_between(views[before], views[after], (after - before) / RATE_HZ)
        capture_ns = round(k * 1e9 / RATE_HZ)
        capture = Capture(number, capture_ns, views[k], motion)
        blind = _BLIND if first <= number < first + kind.black else None
        left, right = camera.take(Shot(number, capture_ns, capture, blind, (), delivered=True))
        yield kind.spoil(StereoPair(left, right, capture_ns, number))


def _stated_camera(kind: SequenceKind, rng: np.random.Generator) -> RectifiedPairSettings:
    width, height = _SIZES[rng.integers(len(_SIZES))] if kind.another_size else (WIDTH, HEIGHT)
    return RectifiedPairSettings(
        fx_px=FOCAL_PX * width / WIDTH,
        fy_px=FOCAL_PX * width / WIDTH,
        cx_px=(width - 1) / 2,
        cy_px=(height - 1) / 2,
        baseline_m=BASELINE_M,
    )
