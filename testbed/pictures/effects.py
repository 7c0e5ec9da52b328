"""Every effect of the emulated camera and its scene, off and on: what the switch is, and two pictures."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from foundation.configuration import merged, validated
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.exposures import STILL, CameraMotion, CameraView, Capture, Exposures
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import LEFT, RIGHT, StereoCamera
from plant_emulator.core.faults.kinds import CameraBlind, CameraFrozen, Fault, FramesDropped, MarkerCovered
from plant_emulator.core.mechanics.geometry import transform
from plant_emulator.core.plant import Plant
from testbed.reporting.console import bars, out, promised, table, write_json
from testbed.scenarios.scenario import load_settings
from vision_pc.application.annotate import png

Grey = NDArray[np.uint8]

COLUMNS = 3
_WIDTH, _HEIGHT = 204, 115  # of one picture
_CAPTION, _GAP = 32, 10
_LEVELS = 12  # of grey, which keeps the file small


class Pair(NamedTuple):
    """What one cell of the sheet shows."""

    title: str
    caption: str
    off: Grey
    on: Grey


def contact_sheet(pairs: Sequence[Pair]) -> Grey:
    """The sheet (height, width) uint8; in each cell the picture without the effect, then with it."""
    wide, high = 2 * _WIDTH + 2 + _GAP, _HEIGHT + _CAPTION + _GAP
    rows = math.ceil(len(pairs) / COLUMNS)
    paper = np.full((rows * high + _GAP, COLUMNS * wide + _GAP), 255, dtype=np.uint8)
    for number, pair in enumerate(pairs):
        top, left = _GAP + number // COLUMNS * high, _GAP + number % COLUMNS * wide
        for text, line, scale in ((pair.title, 11, 0.42), (pair.caption, 26, 0.36)):
            place = (left, top + line)
            cv2.putText(paper, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, 0, 1, cv2.LINE_AA)
        for index, picture in enumerate((pair.off, pair.on)):
            start = left + index * (_WIDTH + 2)
            paper[top + _CAPTION : top + _CAPTION + _HEIGHT, start : start + _WIDTH] = _small(picture)
    return paper


def _small(picture: Grey) -> Grey:
    shrinks = picture.shape[1] > _WIDTH
    small = cv2.resize(
        picture, (_WIDTH, _HEIGHT), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_NEAREST
    )
    step = 255.0 / (_LEVELS - 1)
    return np.asarray(np.rint(np.rint(small / step) * step), dtype=np.uint8)


CLEAN: dict[str, Any] = {
    "wall": {"lighting_gradient_per_m": [0.0, 0.0], "undulation_mm": 0.0, "drill_holes": []},
    "obstacles": [],
    "camera": {
        "blur_px": 0.0,
        "noise_grey": 0.0,
        "vignetting": 0.0,
        "exposure_gain": 1.0,
        "motion_blur_samples": 1,
        "shutter": {"kind": "global"},
        "dropped_frame_share": 0.0,
        "frozen_frame_share": 0.0,
        "rectification": {"vertical_px": 0.0, "disparity_px": 0.0, "right_eye_rotation_deg": [0.0, 0.0, 0.0]},
        "lens": {"k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "k3": 0.0},
    },
}
STRIP = 6  # frames in a row, for the effects that are seen only in time


def _sideways(speed_m_s: float) -> CameraMotion:
    """The arm moving along the wall."""
    return CameraMotion(np.array([[0.0, -speed_m_s, 0.0, 0.0, 0.0, 0.0]] * 2))


class Window(NamedTuple):
    """The part of the picture to be shown: left, top, width, height in pixels."""

    left: int
    top: int
    width: int
    height: int

    def of(self, picture: Grey) -> Grey:
        """That part."""
        return picture[self.top : self.top + self.height, self.left : self.left + self.width]


WHOLE = Window(0, 0, 1280, 720)
OBJECT = Window(480, 180, 480, 270)
MARKER = Window(557, 210, 192, 108)


_SMEAR = {"eye": "left", "centre_px": [400.0, 300.0], "radius_px": 120.0, "transmission": 0.4,
          "scatter_grey": 30.0}  # fmt: skip


class Effect(NamedTuple):
    """One effect. ``switch`` is what one sets, ``on`` the overrides of scene.yaml, or the ``fault`` in force.

    ``off`` are overrides that hold for both pictures. ``in_time``: shown as a strip of successive frames.
    """

    name: str
    switch: str
    on: dict[str, Any]
    off: Mapping[str, Any] = MappingProxyType({})
    fault: Fault | None = None
    window: Window = WHOLE
    eye: int = LEFT
    motion: CameraMotion = STILL
    in_time: bool = False


def _markers(scene: SceneConfig, print_scale_error: float) -> dict[str, Any]:
    """The object's markers, all printed with one scale error."""
    rows = [marker.model_dump(mode="json") for marker in scene.object_of_interest.markers]
    return {
        "object_of_interest": {"markers": [row | {"print_scale_error": print_scale_error} for row in rows]}
    }


def _holes() -> list[dict[str, Any]]:
    places = ((-0.36, 0.16), (-0.36, -0.14), (0.0, -0.16), (0.36, 0.16), (0.36, -0.14))
    return [{"centre_m": list(place), "diameter_mm": 45.0} for place in places]


def effects(scene: SceneConfig) -> tuple[Effect, ...]:
    """Every effect, strong enough to be seen in a small picture."""
    return (*_of_the_camera(), *_of_the_scene(scene), *_of_lost_frames())


def _of_the_camera() -> tuple[Effect, ...]:
    long_exposure = {"camera": {"exposure_us": 40_000}}
    return (
        Effect("exposure", "camera.exposure_gain = 1.9", {"camera": {"exposure_gain": 1.9}}),
        Effect("point spread", "camera.blur_px = 2.5", {"camera": {"blur_px": 2.5}}, window=OBJECT),
        Effect("noise", "camera.noise_grey = 14", {"camera": {"noise_grey": 14.0}}, window=MARKER),
        Effect("vignetting", "camera.vignetting = 0.6", {"camera": {"vignetting": 0.6}}),
        Effect(
            "motion blur", "camera.motion_blur_samples = 12 (40 ms at 0.6 m/s)",
            {"camera": {"motion_blur_samples": 12}}, long_exposure, window=MARKER, motion=_sideways(0.6),
        ),
        Effect(
            "rolling shutter", "camera.shutter.kind = rolling (15 Hz, at 4 m/s)",
            {"camera": {"shutter": {"kind": "rolling", "mode_hz": 15}}}, window=OBJECT, motion=_sideways(4.0),
        ),
        Effect("response curve", "camera.response_gamma = 0.45", {"camera": {"response_gamma": 0.45}}),
        Effect("dirt on a lens", "camera.dirt = [...]", {"camera": {"dirt": [_SMEAR]}}),
        Effect("two lenses", "camera.lens_difference.k1 = 0.05",
               {"camera": {"lens_difference": {"k1": 0.05}}}, eye=RIGHT),
        Effect("lens distortion", "camera.lens.k1 = -0.06", {"camera": {"lens": {"k1": -0.06}}}),
        Effect(
            "rectification, vertical", "camera.rectification.vertical_px = 10",
            {"camera": {"rectification": {"vertical_px": 10.0}}}, window=OBJECT, eye=RIGHT,
        ),
        Effect(
            "rectification, disparity", "camera.rectification.disparity_px = 10",
            {"camera": {"rectification": {"disparity_px": 10.0}}}, window=OBJECT, eye=RIGHT,
        ),
    )  # fmt: skip


def _of_the_scene(scene: SceneConfig) -> tuple[Effect, ...]:
    plate = {"parent": "wall", "centre_m": [-0.2, 0.03, 0.0], "size_m": [0.16, 0.09], "grey": 55.0}
    return (
        Effect("lighting gradient", "wall.lighting_gradient_per_m = [0.3, -0.2]",
               {"wall": {"lighting_gradient_per_m": [0.3, -0.2]}}),
        Effect("shadow", "lighting.shadow.factor = 0.4",
               {"lighting": {"shadow": {"factor": 0.4, "direction_deg": 30.0, "start_m": 0.0}}}),
        Effect("shade of what the arm carries", "lighting.shadow.carried = true",
               {"lighting": {"shadow": {"factor": 0.4, "start_m": 0.1, "speed_m_s": 0.0, "carried": True}}}),
        Effect("glare", "lighting.glare.strength_grey = 150",
               {"lighting": {"glare": {"strength_grey": 150.0, "lamp_m": [-0.12, 0.4, 1.1]}}}, window=OBJECT),
        Effect("low-contrast wall", "wall.contrast_grey = 3", {"wall": {"contrast_grey": 3.0}}),
        Effect("wall not flat", "wall.undulation_mm = 40, waves of 0.3 m",
               {"wall": {"undulation_mm": 40.0, "undulation_length_m": 0.3}}, window=OBJECT),
        Effect("depth steps", "wall.blocks = [...]",
               {"wall": {"blocks": [{"centre_m": [-0.45, 0.0], "size_m": [0.2, 0.5], "depth_m": 0.2}]}}),
        Effect("bare patch", "wall.bare_patches = [...]",
               {"wall": {"bare_patches": [{"centre_m": [0.5, 0.0], "radius_m": 0.25}]}}),
        Effect("wet patch", "wall.bare_patches[].gloss_grey = 150",
               {"wall": {"bare_patches": [{"centre_m": [0.0, -0.05], "radius_m": 0.3, "gloss_grey": 150.0}]},
                "lighting": {"glare": {"lamp_m": [-0.12, 0.4, 1.1]}}}, window=OBJECT),
        Effect("cables", "cables = [...]",
               {"cables": [{"ends_m": [[-1.0, 0.5, 0.15], [1.0, 0.3, 0.15]], "sag_m": 0.35}]}),
        Effect("rebar", "rebar = [...]", {"rebar": [{"centre_m": [0.0, 0.0], "size_m": [2.0, 1.2]}]}),
        Effect("something passes", "passers = [...]",
               {"passers": [{"start_m": [-0.6, 0.0, 0.3], "velocity_m_s": [1.0, 0.0, 0.0]}]}),
        Effect("drill holes", "wall.drill_holes = [...]", {"wall": {"drill_holes": _holes()}}, window=OBJECT),
        Effect("partial occlusion", "obstacles = [...]", {"obstacles": [plate]}, window=OBJECT),
        Effect("print-size error", "markers[].print_scale_error = 0.05", _markers(scene, 0.05),
               _markers(scene, 0.0), window=MARKER),
        Effect("marker covered", "fault marker_covered, share 0.4", {}, window=OBJECT,
               fault=MarkerCovered(marker_id=3, share=0.4, side="top")),
    )  # fmt: skip


def _of_lost_frames() -> tuple[Effect, ...]:
    return (
        Effect("blind", "fault camera_blind, grey 30", {}, fault=CameraBlind(grey=30)),
        Effect("dropped frames", "camera.dropped_frame_share = 0.4", {"camera": {"dropped_frame_share": 0.4}},
               in_time=True),
        Effect("frozen frames", "camera.frozen_frame_share = 0.5", {"camera": {"frozen_frame_share": 0.5}},
               in_time=True),
        Effect("frames lost", "fault frames_dropped, share 0.6", {}, fault=FramesDropped(share=0.6),
               in_time=True),
        Effect("camera frozen", "fault camera_frozen, from the third on", {}, fault=CameraFrozen(),
               in_time=True),
    )  # fmt: skip


def pictured(effect: Effect, scene: SceneConfig, view: CameraView) -> tuple[Grey, Grey]:
    """Pictures without and with ``effect``, from the camera at ``view``, cut to what is to be seen."""
    base = merged(scene.model_dump(mode="json"), merged(CLEAN, effect.off))
    off, on = (
        validated(SceneConfig, merged(base, overrides), f"effect '{effect.name}'")
        for overrides in ({}, effect.on)
    )
    faults = [effect.fault] if effect.fault else []
    if effect.in_time:
        return _strip(off, view, []), _strip(on, view, faults)
    capture = Capture(1, 0, view, effect.motion)
    pictures = []
    for config, in_force in ((off, []), (on, faults)):
        camera = StereoCamera(config.camera, Scene(config), config.seed)
        shot = Exposures(config.camera, config.seed).shot(capture, in_force)
        pictures.append(effect.window.of(camera.take(shot)[effect.eye]))
    return pictures[0], pictures[1]


def _strip(config: SceneConfig, view: CameraView, faults: Sequence[Fault]) -> Grey:
    """Successive frames of an arm that moves sideways, side by side; a frame that never came is black."""
    camera = StereoCamera(config.camera, Scene(config), config.seed)
    exposures = Exposures(config.camera, config.seed)
    frames: list[Grey] = []
    for capture in _moving(view):
        shot = exposures.shot(capture, faults if capture.frame_id >= 2 else [])
        left = camera.take(shot)[LEFT] if shot.delivered else np.zeros((720, 1280), dtype=np.uint8)
        small = cv2.resize(OBJECT.of(left), (160, 90), interpolation=cv2.INTER_AREA)
        frames.append(cv2.copyMakeBorder(small, 2, 2, 2, 2, cv2.BORDER_CONSTANT, value=255))  # type: ignore[arg-type]
    half = STRIP // 2
    return np.vstack([np.hstack(frames[:half]), np.hstack(frames[half:])])


def _moving(view: CameraView) -> Iterator[Capture]:
    step = transform(np.eye(3), np.array([0.06, 0.0, 0.0]))
    for number in range(STRIP):
        yield Capture(number, number, view, STILL)
        view = CameraView(view.X_WC @ step, view.X_WM @ step)


_HEADINGS = ("effect", "switch in scene.yaml, or fault", "mean change, grey", "pixels changed, %")


def draw_effects(config_dir: Path, directory: Path, json_file: Path | None) -> None:
    """Write the pictures into ``directory``, and what each effect changes to stdout and ``json_file``."""
    settings = load_settings(config_dir, {})
    truth = Plant(settings.plant, 1, Scene(settings.scene).mounts).truth()
    view = CameraView(truth.X_WC, truth.X_WM)
    promised(directory).mkdir(parents=True, exist_ok=True)
    wanted, pairs, rows = effects(settings.scene), [], []
    with bars() as shown, shown.step("rendering") as bar:
        for number, effect in enumerate(wanted, 1):
            off, on = pictured(effect, settings.scene, view)
            stem = effect.name.replace(",", "").replace(" ", "_")
            for state, picture in (("off", off), ("on", on)):
                promised(directory / f"{stem}_{state}.png").write_bytes(png(picture))
            change = np.abs(on.astype(float) - off)
            rows.append((effect.name, effect.switch, change.mean(), 100.0 * (change > 0.0).mean()))
            pairs.append(Pair(effect.name, effect.switch, off, on))
            bar.update(number / len(wanted), effect.name)
    path = promised(directory / "camera_effects.png")
    path.write_bytes(png(contact_sheet(pairs)))
    shown_rows = [(name, switch, f"{mean:.2f}", f"{share:.1f}") for name, switch, mean, share in rows]
    out.print(table("effects of camera and scene, off against on", _HEADINGS, shown_rows))
    out.print(f"{path}: {path.stat().st_size / 1000:.0f} kB", highlight=False)
    keys = ("name", "switch", "mean_change_grey", "changed_percent")
    write_json(json_file, {"effects": [dict(zip(keys, row, strict=True)) for row in rows]})
