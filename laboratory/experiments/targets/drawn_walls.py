"""Walls with drill holes drawn from a seed, and one stereo pair of each with the tool's marker in view.

Everything that differs from one camera to the next is drawn with the spread that vision takes for granted:
so errors can be compared with what vision tells of them. Walls come in groups of one texture, for to paint a
texture costs more than all the rest.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.surroundings import WallConfig
from plant_emulator.core.camera.eye import true_eyes
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.camera.wall.bores import height_of_wall
from testbed.scenarios.scenario import Settings, load_settings
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.look import observe
from vision_pc.core.se3 import Array
from vision_pc.core.targets.sighting import Sighted
from vision_pc.core.targets.target import frame_on
from vision_pc.core.types import CameraCalibration, CameraModel, StereoOffset, StereoPair

GROUP = 10  # seeds that share a texture, its contrast and its stains
HOLE_MM = 45.0
_DECOYS_MM = (28.0, 70.0)  # holes of other widths: to find one of them is to find what is not there
_AROUND = ((0.20, 0.02), (-0.19, 0.05), (0.03, 0.21), (-0.02, -0.20), (0.21, -0.19))
_OFF_AXIS = 0.21  # 12 degrees
_RIM_PX = 75.0
_CLEARANCE_M = 0.1  # of the tool before the wall, where it is at the goal
_TOOL_PX = 115.0  # half of what plate and bracket hide to either side, with room for the surface around
_BOARD = {"kind": "checkerboard", "columns": 40, "rows": 40}
_STREAM = 0x77616C6C
JSON = dict[str, Any]


class Aspect(NamedTuple):
    """How a wall is looked at: distance (m), least and greatest tilt (degrees); what its rims have lost.

    ``broken``: least and greatest share of the radius; None: there are no holes.
    """

    distance_m: float
    tilt_deg: tuple[float, float] = (0.0, 20.0)
    broken: tuple[float, float] | None = (0.0, 0.15)


class DrawnWall(NamedTuple):
    """One pair: as vision sees it, as an eye of known optics would, and what is true in C.

    ``aim`` (4, 4): X_CO of what is looked at, its ``pixel`` in the left eye. ``places`` (n, 3): middles of
    all holes of the right width; ``whole`` (n,): both eyes show its surroundings.
    """

    seen: Sighted
    known: Sighted
    aim: Array
    pixel: Array
    places: Array
    whole: NDArray[np.bool_]
    contrast: float
    tilt_deg: float


def drawn_wall(config_dir: Path, seed: int, aspect: Aspect, over: Mapping[str, Any]) -> DrawnWall:
    """The wall of ``seed``; ``over`` lies over what is drawn of the wall. With ``square_m`` among it there is
    a chessboard of such squares where the eyes look.
    """
    rng = np.random.default_rng([seed, _STREAM, round(1000.0 * aspect.distance_m)])
    wall: JSON = _wall(np.random.default_rng([seed // GROUP, _STREAM])) | _relief(rng) | dict(over)
    square_m = wall.pop("square_m", None)
    place = rng.uniform(-1.2, 1.2, 2)
    if aspect.broken is not None:
        wall["drill_holes"] = _holes(rng, place, aspect.broken)
    scene = {"seed": seed, "wall": wall, "lighting": {"shadow": _shadow(rng)}}
    scene["object_of_interest"] = {"markers": []}
    if square_m is not None:
        wall["undulation_mm"] = 0.0
        scene["boards"] = [_BOARD | {"square_m": square_m, "position_m": [*place.tolist(), 1e-4]}]
    usual = load_settings(config_dir, {})
    scene["camera"], scene["tool_marker"] = _camera(rng, usual), _tool(rng, usual)
    return _render_wall(load_settings(config_dir, {"scene": scene}), rng, place, aspect)


def _wall(rng: np.random.Generator) -> JSON:
    """What is painted: texture, contrast, stains."""
    stains = [
        {
            "centre_m": rng.uniform(-1.5, 1.5, 2).tolist(),
            "radius_m": rng.uniform(0.1, 0.3),
            "contrast": rng.uniform(0.4, 0.8),
        }
        for _ in range(4)
    ]
    return {
        "texture_seed": int(rng.integers(2**31)),
        "mean_grey": rng.uniform(100.0, 135.0),
        "contrast_grey": rng.uniform(10.0, 25.0),
        "bare_patches": stains,
    }


def _relief(rng: np.random.Generator) -> JSON:
    return {
        "undulation_mm": rng.uniform(0.0, 4.0),
        "undulation_length_m": rng.uniform(0.7, 1.5),
        "lighting_gradient_per_m": rng.uniform(-0.12, 0.12, 2).tolist(),
    }


def _holes(rng: np.random.Generator, place: Array, broken: tuple[float, float]) -> list[JSON]:
    """The one that is looked at first, then others of its width and some that are none of ours."""
    widths = [HOLE_MM, HOLE_MM, HOLE_MM, HOLE_MM, *_DECOYS_MM]
    return [
        {
            "centre_m": (place + around + (rng.uniform(-0.03, 0.03, 2) if number else 0.0)).tolist(),
            "diameter_mm": width,
            "depth_m": rng.uniform(0.2, 1.5),
            "broken": rng.uniform(*broken),
            "grey": int(rng.integers(8, 35)),
            "rim_grey": int(rng.integers(120, 185)),
            "seed": int(rng.integers(2**31)),
        }
        for number, (width, around) in enumerate(zip(widths, ((0.0, 0.0), *_AROUND), strict=True))
    ]


def _shadow(rng: np.random.Generator) -> JSON:
    """In three of ten pictures the edge of a shade lies somewhere on the wall."""
    return {
        "factor": float(rng.uniform(0.4, 0.9)) if rng.uniform() < 0.3 else 1.0,
        "direction_deg": rng.uniform(-180.0, 180.0),
        "start_m": rng.uniform(-1.0, 1.0),
        "penumbra_m": rng.uniform(0.01, 0.06),
    }


def _camera(rng: np.random.Generator, usual: Settings) -> JSON:
    """Optics off the calibration by what vision's settings say of them; noise, blur and light [E]."""
    markers, camera = usual.vision.markers, usual.vision.camera
    nominal = intrinsics.calibration(camera)
    focal = float(nominal.left.K[0, 0]) * (1.0 + markers.focal_std * rng.standard_normal())
    baseline = float(np.linalg.norm(nominal.right.X_CE[:3, 3]))
    return {
        "baseline_m": baseline * (1.0 + markers.calibration.baseline * rng.standard_normal()),
        "lens": {
            "fx_px": focal, "fy_px": focal,
            "cx_px": float(nominal.left.K[0, 2]), "cy_px": float(nominal.left.K[1, 2]),
            "k1": 0.001 * rng.standard_normal(), "k2": 0.0, "p1": 0.0, "p2": 0.0,
        },
        "rectification": {
            "disparity_px": rng.uniform(-0.5, 0.5),
            "vertical_px": rng.uniform(-0.5, 0.5),
            "right_eye_rotation_deg": [0.0, 0.0, 0.003 * rng.standard_normal()],
        },
        "noise_grey": rng.uniform(1.5, 4.0),
        "blur_px": rng.uniform(0.5, 0.9),
        "exposure_gain": rng.uniform(0.8, 1.25),
    }  # fmt: skip


def _tool(rng: np.random.Generator, usual: Settings) -> JSON:
    return {"print_scale_error": usual.vision.markers.print_size_std * rng.standard_normal()}


def _render_wall(settings: Settings, rng: np.random.Generator, place: Array, aspect: Aspect) -> DrawnWall:
    config, scene = settings.scene, Scene(settings.scene)
    camera = StereoCamera(config.camera, scene, config.seed)
    turned = np.diag([1.0, -1.0, -1.0]) @ se3.exp_so3(0.1 * rng.standard_normal(3))
    beside = [rng.choice([-1.0, 1.0]) * rng.uniform(0.17, 0.22), rng.uniform(0.02, 0.1)]
    before = min(rng.uniform(0.38, 0.45), aspect.distance_m - _CLEARANCE_M)
    X_CM = se3.transform(turned, [*beside, before])
    point = np.array([*place, height_of_wall(config.wall, *place)])
    tilt = rng.uniform(*aspect.tilt_deg)
    while True:
        X_CO = _looked_at(rng, point, aspect.distance_m, tilt)
        pixels = camera.project(np.eye(4), se3.apply(X_CO, point[None]))
        tool = camera.project(np.eye(4), X_CM[None, :3, 3])
        if all(_clear(at[0], of[0], config.camera) for at, of in zip(pixels, tool, strict=True)):
            break
    X_WC = scene.mounts.X_WO @ se3.inverse(X_CO)
    pair = StereoPair(*camera.render(X_WC, X_WC @ X_CM, settings.scene.seed % 1000), 0, settings.scene.seed)
    places = _places(config.wall, X_CO)
    markers, targets = settings.vision.markers, settings.vision.targets
    nominal = intrinsics.calibration(settings.vision.camera)
    observation = observe(pair, nominal, markers)
    told = observation._replace(offset=StereoOffset(0.0, 0.0, 1e-6, 1e-6))
    return DrawnWall(
        Sighted(pair, nominal, observation, markers, targets),
        Sighted(pair, true_calibration(settings), told, markers, targets),
        aim=_frame(config.wall, X_CO, place),
        pixel=pixels[0][0],
        places=places,
        whole=_whole(camera, places, tool),
        contrast=config.wall.contrast_grey,
        tilt_deg=tilt,
    )


def _looked_at(rng: np.random.Generator, point: Array, distance_m: float, tilt_deg: float) -> Array:
    """X_CO (4, 4): ``point`` of O lies ``distance_m`` deep, up to 12 degrees off the axis."""
    about, roll = rng.uniform(0.0, 2.0 * np.pi), np.radians(rng.uniform(-10.0, 10.0))
    tilt = np.radians(tilt_deg) * np.array([np.cos(about), np.sin(about), 0.0])
    R_CO = se3.exp_so3(np.array([0.0, 0.0, roll])) @ se3.exp_so3(tilt) @ np.diag([1.0, -1.0, -1.0])
    p_C = distance_m * np.append(rng.uniform(-_OFF_AXIS, _OFF_AXIS, 2), 1.0)
    return se3.transform(R_CO, p_C - R_CO @ point)


def _clear(pixel: Array, tool: Array, camera: Any) -> bool:
    """Whether an eye sees the surroundings of ``pixel`` whole, beside the tool and what carries it."""
    size = np.array([camera.width_px, camera.height_px])
    inside = bool(np.all(pixel > _RIM_PX) and np.all(pixel < size - 1.0 - _RIM_PX))
    beside = abs(pixel[0] - tool[0]) > 1.6 * _TOOL_PX
    return inside and bool(beside or pixel[1] < tool[1] - 1.6 * _TOOL_PX)


def _places(wall: WallConfig, X_CO: Array) -> Array:
    """Middles (n, 3) in C of the holes of our width."""
    ours = [np.array(hole.centre_m) for hole in wall.drill_holes if hole.diameter_mm == HOLE_MM]
    return np.array([_frame(wall, X_CO, place)[:3, 3] for place in ours]).reshape(-1, 3)


def _whole(camera: StereoCamera, places: Array, tool: Any) -> NDArray[np.bool_]:
    """Which of the ``places`` (n, 3) in C both eyes show with their surroundings."""
    if not len(places):
        return np.zeros(0, dtype=bool)
    eyes = camera.project(np.eye(4), places)
    clear = [[_clear(pixel, of[0], camera.config) for pixel in at] for at, of in zip(eyes, tool, strict=True)]
    return np.asarray(np.all(clear, axis=0))


def _frame(wall: WallConfig, X_CO: Array, place: Array) -> Array:
    """The target's true frame in C at ``place`` (2,) of the wall, its normal that of what is around."""
    turns = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    ring = place + 0.0005 * HOLE_MM * np.column_stack([np.cos(turns), np.sin(turns)])
    heights = np.array([height_of_wall(wall, x, y) for x, y in ring])
    slopes = np.linalg.lstsq(np.column_stack([ring - place, np.ones(24)]), heights, rcond=None)[0]
    p = se3.apply(X_CO, np.array([[*place, slopes[2]]]))[0]
    return frame_on(p, X_CO[:3, :3] @ np.array([-slopes[0], -slopes[1], 1.0]))


def true_calibration(settings: Settings) -> CameraCalibration:
    """The eyes as they truly are, in vision's terms."""
    config = settings.scene.camera
    lenses = (config.lens, config.lens_difference.added_to(config.lens))
    eyes = []
    for true, lens in zip(true_eyes(config), lenses, strict=True):
        K = np.diag([*true.lens.focal, 1.0])
        K[:2, 2] = true.lens.centre
        eyes.append(CameraModel(K, np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]), true.X_CE))
    return CameraCalibration(config.width_px, config.height_px, *eyes)
