"""What can be measured of an arm and its eyes under one choice of errors; units are in the names."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.scene import Scene, printed_side
from plant_emulator.core.camera.stereo_camera import LEFT, StereoCamera
from plant_emulator.core.camera.true_eye import true_eyes
from plant_emulator.core.plant import NOMINAL_MOUNTS, Plant
from plant_emulator.core.truth import inverse
from protocol.process_image import CONTROL_ENABLE, COUNTS_PER_TURN, ValveImage

Array = NDArray[np.float64]


class MeasuredWorld(NamedTuple):
    """Arm and visible world under one choice of switches."""

    plant: PlantConfig
    scene: SceneConfig

    def arm(self) -> Plant:
        """A fresh plant at rest."""
        return Plant(self.plant, 1, Scene(self.scene).mounts)


def _driven(world: MeasuredWorld, spools: list[tuple[float, float]]) -> Plant:
    """A plant after half-seconds with these openings of slew and lift."""
    plant, cycle = world.arm(), 0
    for slew, lift in spools:
        for _ in range(100):
            cycle += 1
            plant.write(ValveImage(cycle, CONTROL_ENABLE, (slew, lift, 0.0, 0.0, 0.0, 0.0)))
            plant.advance(5_000_000)
    return plant


def tool_mm(world: MeasuredWorld) -> Array:
    """The tool in the world (3,), mm."""
    return np.asarray(world.arm().truth().X_WT[:3, 3] * 1e3)


def tool_turned_mrad(world: MeasuredWorld) -> Array:
    """The tool's axes in the world (9,), in units of which a turn by 1 mrad changes them by 1."""
    return np.asarray(world.arm().truth().X_WT[:3, :3].ravel() * 1e3 / np.sqrt(2.0))


def shaken_mm(world: MeasuredWorld) -> Array:
    """How far the tool is from its mean place over the third second at rest, rms, mm."""
    plant, places = world.arm(), []
    plant.advance(2_000_000_000)
    for _ in range(500):
        plant.advance(2_000_000)
        places.append(plant.truth().X_WT[:3, 3])
    return np.asarray(1e3 * np.linalg.norm(np.std(places, axis=0)))


def _read_mrad(plant: Plant) -> Array:
    return np.asarray(np.array(plant.read().encoder_counts) * (2e3 * np.pi / COUNTS_PER_TURN))


def reading_mrad(world: MeasuredWorld) -> Array:
    """The encoders' readings (6,) at rest."""
    return _read_mrad(world.arm())


def trailing_mrad(world: MeasuredWorld) -> float:
    """Reading minus true angle of a slew that turns."""
    plant = _driven(world, [(0.2, 0.0)])
    return float((_read_mrad(plant) - plant.truth().q * 1e3)[0])


def noise_lsb(world: MeasuredWorld) -> float:
    """Spread of the readings at rest, in counts."""
    plant = world.arm()
    return float(np.std([plant.read().encoder_counts for _ in range(500)], axis=0).mean())


def slew_mrad_s(world: MeasuredWorld, spool: float) -> float:
    """Speed of the slew at ``spool``."""
    return float(_driven(world, [(spool, 0.0)] * 3).truth().q_rate[0] * 1e3)


def sunk_mm(world: MeasuredWorld) -> float:
    """Height of the tool after 20 s with every valve shut."""
    plant = world.arm()
    plant.advance(20_000_000_000)
    return float(plant.truth().X_WT[2, 3] * 1e3)


def oil_k(world: MeasuredWorld) -> float:
    """Oil temperature after 4 s of lifting and lowering."""
    return _driven(world, [(0.0, 0.5), (0.0, -0.5)] * 4).truth().oil_temperature_degc


def _turned_deg(X: Array) -> Array:
    """The rotation vector (3,) of a small turn from the nearest axes, in degrees."""
    skew = X[:3, :3] - X[:3, :3].T
    return np.degrees(np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / 2.0)


def _mount(world: MeasuredWorld) -> Array:
    truth = world.arm().truth()
    return inverse(truth.X_WT) @ truth.X_WC


def mount_mm(world: MeasuredWorld) -> Array:
    """The camera in T (3,), mm."""
    return np.asarray(_mount(world)[:3, 3] * 1e3)


def mount_deg(world: MeasuredWorld) -> Array:
    """The camera's turn against T (3,)."""
    return _turned_deg(_mount(world))


def _marker(world: MeasuredWorld) -> Array:
    truth = world.arm().truth()
    return inverse(NOMINAL_MOUNTS.X_TM) @ inverse(truth.X_WT) @ truth.X_WM


def marker_mm(world: MeasuredWorld) -> Array:
    """The tool marker off its nominal place (3,), mm."""
    return np.asarray(_marker(world)[:3, 3] * 1e3)


def marker_deg(world: MeasuredWorld) -> Array:
    """The tool marker's turn against nominal (3,)."""
    return _turned_deg(_marker(world))


def printed_mm(world: MeasuredWorld) -> float:
    """Side of the tool marker as printed."""
    return 1e3 * printed_side(world.scene.tool_marker)


def image_px(world: MeasuredWorld, eye: int) -> Array:
    """Image coordinates of an even grid of rays, divided by √n: the length of a difference is its rms."""
    true = true_eyes(world.scene.camera)[eye]
    x, y = np.meshgrid(np.linspace(-1.1, 1.1, 23), np.linspace(-0.6, 0.6, 13))
    rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1) @ true.X_CE[:3, :3]
    return np.asarray(true.lens.project(rays).ravel() / np.sqrt(x.size))


def noise_grey(world: MeasuredWorld) -> float:
    """Spread of a pixel from picture to picture."""
    camera = StereoCamera(world.scene.camera, Scene(world.scene), world.scene.seed)
    truth = world.arm().truth()
    pictures = [camera.render(truth.X_WC, truth.X_WM, frame)[LEFT].astype(float) for frame in (1, 2)]
    return float(np.std(pictures[1] - pictures[0]) / np.sqrt(2.0))
