"""Every source of error of the plant by itself: its switch, where its number comes from, what it alone does.

The base is an arm and a camera without any of them; each is then switched on alone, with the shipped numbers.
What else disturbs a picture is shown by `longreach picture effects`.
"""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from plant_emulator.core.lens import Lens
from plant_emulator.core.plant import NOMINAL_MOUNTS, Plant
from plant_emulator.core.scene import Scene, printed_side
from plant_emulator.core.stereo_camera import LEFT, StereoCamera, true_eyes
from plant_emulator.core.truth import inverse
from plant_emulator.plant_config import PlantConfig
from plant_emulator.scene_config import SceneConfig
from protocol.configuration import load, merged
from protocol.errors import ConfigurationError
from protocol.process_image import CONTROL_ENABLE, COUNTS_PER_TURN, ValveImage

Array = NDArray[np.float64]
Keys = dict[str, Any]

_OFF: Keys = {"enabled": False}
_MARK = re.compile(r"#.*?(\[[SMERD]\])")


class World(NamedTuple):
    """Arm and visible world under one choice of switches."""

    plant: PlantConfig
    scene: SceneConfig

    def arm(self) -> Plant:
        """A fresh plant at rest."""
        return Plant(self.plant, 1, Scene(self.scene).mounts)


class Source(NamedTuple):
    """One source. ``key``: file and dotted key, where its number and provenance stand. ``off``: what takes it
    away, by file.

    ``measure`` makes of a world a number or vector in ``unit``; what the source alone does is the length of
    the difference that it makes, or the change in percent where the unit is ``%``.
    """

    name: str
    key: str
    off: Keys
    measure: Callable[[World], Array | float]
    effect: str
    unit: str


class Finding(NamedTuple):
    """What one source alone does."""

    name: str
    key: str
    provenance: str
    effect: str
    unit: str
    value: float


def sources(nominal_lens: Keys) -> tuple[Source, ...]:
    """Every source of error; ``nominal_lens`` is what the vision side takes the lens for."""

    def error(name: str) -> Keys:
        return {"plant": {"errors": {name: _OFF}}}

    marker: Keys = {
        "offset_m": [0.0, 0.0, 0.0],
        "misalignment_deg": [0.0, 0.0, 0.0],
        "print_scale_error": 0.0,
    }
    level = {"vertical_px": 0.0, "disparity_px": 0.0, "right_eye_rotation_deg": [0.0, 0.0, 0.0]}
    straight = {"k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "k3": 0.0}
    return (
        Source("boom flexibility", "plant.flexibility", {"plant": {"flexibility": _OFF}}, _tool_mm,
               "tool sags at the start pose", "mm"),
        Source("geometry", "plant.errors.geometry", error("geometry"), _tool_mm,
               "tool off the rigid model", "mm"),
        Source("base tilt", "plant.errors.base_tilt", error("base_tilt"), _tool_mm, "tool moves in the world",
               "mm"),
        Source("encoder offsets", "plant.errors.encoder_offsets", error("encoder_offsets"), _reading_mrad,
               "readings off, all six", "mrad"),
        Source("encoder noise", "plant.errors.encoder_noise", error("encoder_noise"), _noise_lsb,
               "spread of readings at rest", "LSB"),
        Source("backlash", "plant.errors.backlash", error("backlash"), _trailing_mrad,
               "reading trails a turning slew", "mrad"),
        Source("valve deadband", "plant.valves.deadband", error("valve_deadband"),
               lambda world: _slew_mrad_s(world, 0.02), "slew speed at 2 % spool", "%"),
        Source("friction", "plant.actuators.slew.rotary.friction", error("friction"),
               lambda world: _slew_mrad_s(world, 0.1), "slew speed at 10 % spool", "%"),
        Source("leakage", "plant.actuators.slew.leakage_m3_s_pa", error("leakage"), _sunk_mm,
               "tool sinks in 60 s, valves shut", "mm"),
        Source("thermal drift", "plant.oil.temperature_degc", {"plant": {"oil": {"thermal_drift": False}}},
               _oil_k, "oil warms in 4 s of full work", "K"),
        Source("camera mount, position", "scene.mount.position_m",
               {"scene": {"mount": {"position_m": NOMINAL_MOUNTS.X_TC[:3, 3].tolist()}}}, _mount_mm,
               "camera off its nominal place", "mm"),
        Source("camera mount, rotation", "scene.mount.rotation_deg",
               {"scene": {"mount": {"rotation_deg": [0.0, 0.0, 0.0]}}}, _mount_deg, "camera turned", "deg"),
        Source("tool marker, offset", "scene.tool_marker.offset_m", {"scene": {"tool_marker": marker}},
               _marker_mm, "tool marker off the tool", "mm"),
        Source("tool marker, misalignment", "scene.tool_marker.misalignment_deg",
               {"scene": {"tool_marker": marker}}, _marker_deg, "tool marker turned", "deg"),
        Source("print size", "scene.tool_marker.print_scale_error", {"scene": {"tool_marker": marker}},
               _printed_mm, "printed side off", "mm"),
        Source("lens", "scene.camera.lens.fx_px", {"scene": {"camera": {"lens": nominal_lens | straight}}},
               lambda world: _image_px(world, 0), "image off, rms over the left picture", "px"),
        Source("rectification", "scene.camera.rectification.vertical_px",
               {"scene": {"camera": {"rectification": level}}},
               lambda world: _image_px(world, 1), "image off, rms over the right picture", "px"),
        Source("picture noise", "scene.camera.noise_grey", {"scene": {"camera": {"noise_grey": 0.0}}},
               _noise_grey, "spread of a pixel", "grey"),
    )  # fmt: skip


def findings(config_dir: Path, nominal_lens: Keys) -> Iterator[Finding]:
    """What each source alone does, one after the other.

    Raises ConfigurationError when a source's key has no provenance.
    """
    known = sources(nominal_lens)
    off: Keys = {}
    for source in known:
        off = merged(off, source.off)
    base = _world(config_dir, off)
    for source in known:
        others: Keys = {}
        for other in known:
            if other.off != source.off:
                others = merged(others, other.off)
        alone, without = (np.asarray(source.measure(world)) for world in (_world(config_dir, others), base))
        change = float(np.linalg.norm(alone - without))
        value = 100.0 * float((alone - without) / without) if source.unit == "%" else change
        mark = provenance(config_dir, source.key)
        yield Finding(source.name, source.key, mark, source.effect, source.unit, value)


def provenance(config_dir: Path, key: str) -> str:
    """The mark beside ``key`` (file, then dotted key), or beside the first number below it.

    Raises ConfigurationError when the key does not exist or has none.
    """
    stem, *path = key.split(".")
    file = config_dir / f"{stem}.yaml"
    lines = file.read_text(encoding="utf-8").splitlines()
    node = yaml.compose("\n".join(lines), Loader=yaml.SafeLoader)
    first = last = 0
    for part in path:
        pairs = node.value if isinstance(node, yaml.MappingNode) else []
        found = next(((name, value) for name, value in pairs if name.value == part), None)
        if found is None:
            raise ConfigurationError("configuration.no_such_key", f"{file}: {key}: there is no '{part}'")
        first, node = found[0].start_mark.line, found[1]
        last = max(node.end_mark.line, first + 1)
    for line in lines[first:last]:
        if mark := _MARK.search(line):
            return mark.group(1)
    raise ConfigurationError("configuration.no_provenance", f"{file}: {key}: no [S], [M], [E], [R] or [D]")


def _world(config_dir: Path, overrides: Keys) -> World:
    plant = load(PlantConfig, config_dir / "plant.yaml", overrides.get("plant"))
    return World(plant, load(SceneConfig, config_dir / "scene.yaml", overrides.get("scene")))


def _driven(world: World, spools: list[tuple[float, float]]) -> Plant:
    """A plant after half-seconds with these openings of slew and lift."""
    plant, cycle = world.arm(), 0
    for slew, lift in spools:
        for _ in range(100):
            cycle += 1
            plant.write(ValveImage(cycle, CONTROL_ENABLE, (slew, lift, 0.0, 0.0, 0.0, 0.0)))
            plant.advance(5_000_000)
    return plant


def _tool_mm(world: World) -> Array:
    return np.asarray(world.arm().truth().X_WT[:3, 3] * 1e3)


def _read_mrad(plant: Plant) -> Array:
    return np.asarray(np.array(plant.read().encoder_counts) * (2e3 * np.pi / COUNTS_PER_TURN))


def _reading_mrad(world: World) -> Array:
    return _read_mrad(world.arm())


def _trailing_mrad(world: World) -> float:
    plant = _driven(world, [(0.2, 0.0)])
    return float((_read_mrad(plant) - plant.truth().q * 1e3)[0])


def _noise_lsb(world: World) -> float:
    plant = world.arm()
    return float(np.std([plant.read().encoder_counts for _ in range(500)], axis=0).mean())


def _slew_mrad_s(world: World, spool: float) -> float:
    return float(_driven(world, [(spool, 0.0)] * 3).truth().q_rate[0] * 1e3)


def _sunk_mm(world: World) -> float:
    plant = world.arm()
    plant.advance(60_000_000_000)
    return float(plant.truth().X_WT[2, 3] * 1e3)


def _oil_k(world: World) -> float:
    return _driven(world, [(0.0, 0.5), (0.0, -0.5)] * 4).truth().oil_temperature_degc


def _turned_deg(X: Array) -> Array:
    """The rotation vector (3,) of a small turn from the nearest axes, in degrees."""
    skew = X[:3, :3] - X[:3, :3].T
    return np.degrees(np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / 2.0)


def _mount(world: World) -> Array:
    truth = world.arm().truth()
    return inverse(truth.X_WT) @ truth.X_WC


def _mount_mm(world: World) -> Array:
    return np.asarray(_mount(world)[:3, 3] * 1e3)


def _mount_deg(world: World) -> Array:
    return _turned_deg(_mount(world))


def _marker(world: World) -> Array:
    truth = world.arm().truth()
    return inverse(NOMINAL_MOUNTS.X_TM) @ inverse(truth.X_WT) @ truth.X_WM


def _marker_mm(world: World) -> Array:
    return np.asarray(_marker(world)[:3, 3] * 1e3)


def _marker_deg(world: World) -> Array:
    return _turned_deg(_marker(world))


def _printed_mm(world: World) -> float:
    return 1e3 * printed_side(world.scene.tool_marker)


def _image_px(world: World, eye: int) -> Array:
    """Image coordinates of an even grid of rays, divided by √n: the length of a difference is its rms."""
    lens: Lens
    lens, X_CE = true_eyes(world.scene.camera)[eye]
    x, y = np.meshgrid(np.linspace(-1.1, 1.1, 23), np.linspace(-0.6, 0.6, 13))
    rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1) @ X_CE[:3, :3]
    return np.asarray(lens.project(rays).ravel() / np.sqrt(x.size))


def _noise_grey(world: World) -> float:
    camera = StereoCamera(world.scene.camera, Scene(world.scene), world.scene.seed)
    truth = world.arm().truth()
    pictures = [camera.render(truth.X_WC, truth.X_WM, frame)[LEFT].astype(float) for frame in (1, 2)]
    return float(np.std(pictures[1] - pictures[0]) / np.sqrt(2.0))
