"""The plant as an FMU (FMI 2.0, co-simulation), its configuration and seed inside.

An FMU of a tool, as the standard calls it: it steps the plant of the Longreach that is installed where the
simulator runs, so that there is one plant and no second implementation of the oil.
"""

import json
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.plant import Plant
from protocol.errors import ConfigurationError
from protocol.process_image import CONTROL_ENABLE, COUNTS_PER_TURN, ValveImage
from testbed.scenarios.settings import Settings

_SLAVE = Path(__file__).with_name("fmu_slave.py")
JOINTS = ("slew", "lift", "tilt", "wrist1", "wrist2", "wrist3")
_PA = 1e5  # of a bar


def write_fmu(settings: Settings, seed: int, target: Path) -> None:
    """Write the FMU of the plant of ``settings``. Raises ConfigurationError without PythonFMU, OSError."""
    try:
        from pythonfmu.builder import FmuBuilder
    except ImportError as error:
        raise ConfigurationError(
            "configuration.missing_package", "export fmu needs PythonFMU: pip install 'longreach[fmu]'"
        ) from error
    with tempfile.TemporaryDirectory() as folder:
        configured = Path(folder) / "plant.json"
        plant, scene = (each.model_dump(mode="json") for each in (settings.plant, settings.scene))
        configured.write_text(json.dumps({"plant": plant, "scene": scene, "seed": seed}), encoding="utf-8")
        made = FmuBuilder.build_FMU(_SLAVE, dest=folder, project_files=[configured])
        shutil.move(made, target)


def plant_of(file: Path) -> Plant:
    """The plant at rest that ``write_fmu`` has put into an FMU."""
    told = json.loads(file.read_text(encoding="utf-8"))
    plant, scene = PlantConfig.model_validate(told["plant"]), SceneConfig.model_validate(told["scene"])
    return Plant(plant, told["seed"], Scene(scene).mounts)


def step(plant: Plant, number: int, valves: Sequence[float], step_s: float) -> None:
    """Let ``step_s`` pass after six spool commands, those of step ``number``.

    Longer steps than the plant's watchdog end with closed valves, as when a controller dies.
    """
    slew, lift, tilt, wrist1, wrist2, wrist3 = (float(np.clip(valve, -1.0, 1.0)) for valve in valves)
    commands = (slew, lift, tilt, wrist1, wrist2, wrist3)
    plant.write(ValveImage(number & 0xFFFFFFFF, CONTROL_ENABLE, commands))
    plant.advance(round(1e9 * step_s))


def outputs_of(plant: Plant) -> dict[str, float]:
    """What an FMU tells, by name: the sensors as the fieldbus gives them in SI units, and the truth."""
    sensors, truth = plant.read(), plant.truth()
    told = dict[str, float]()
    for k, joint in enumerate(JOINTS):
        told[f"encoder_{joint}_rad"] = 2.0 * np.pi * sensors.encoder_counts[k] / COUNTS_PER_TURN
        for chamber, bar in zip("ab", sensors.pressures_bar[k], strict=True):
            told[f"pressure_{joint}_{chamber}_pa"] = _PA * bar
        told[f"true_q_{joint}_rad"] = float(truth.q[k])
    for axis, metres in zip("xyz", truth.X_WT[:3, 3].tolist(), strict=True):
        told[f"true_tool_{axis}_m"] = metres
    return told
