"""One picture per effect of camera and scene, off and on, and all of them on one sheet."""

from pathlib import Path

import cv2
import numpy as np

from plant_emulator.core.camera.exposures import CameraView
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.plant import Plant
from testbed.pictures.effects import effects, pictured
from testbed.pictures.sheet import Pair, contact_sheet
from testbed.reporting.console import bars, out, table, write_json
from testbed.scenarios.settings import load_settings

_HEADINGS = ("effect", "switch in scene.yaml, or fault", "mean change, grey", "pixels changed, %")


def draw_effects(config_dir: Path, directory: Path, json_file: Path | None) -> None:
    """Write the pictures into ``directory``, and what each effect changes to stdout and ``json_file``."""
    settings = load_settings(config_dir, {})
    truth = Plant(settings.plant, 1, Scene(settings.scene).mounts).truth()
    view = CameraView(truth.X_WC, truth.X_WM)
    directory.mkdir(parents=True, exist_ok=True)
    wanted, pairs, rows = effects(settings.scene), [], []
    with bars() as shown, shown.step("rendering") as bar:
        for number, effect in enumerate(wanted, 1):
            off, on = pictured(effect, settings.scene, view)
            stem = effect.name.replace(",", "").replace(" ", "_")
            for state, picture in (("off", off), ("on", on)):
                cv2.imwrite(str(directory / f"{stem}_{state}.png"), picture)
            change = np.abs(on.astype(float) - off)
            rows.append((effect.name, effect.switch, change.mean(), 100.0 * (change > 0.0).mean()))
            pairs.append(Pair(effect.name, effect.switch, off, on))
            bar.update(number / len(wanted), effect.name)
    path = directory / "camera_effects.png"
    cv2.imwrite(str(path), contact_sheet(pairs), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    shown_rows = [(name, switch, f"{mean:.2f}", f"{share:.1f}") for name, switch, mean, share in rows]
    out.print(table("effects of camera and scene, off against on", _HEADINGS, shown_rows))
    out.print(f"{path}: {path.stat().st_size / 1000:.0f} kB", highlight=False)
    keys = ("name", "switch", "mean_change_grey", "changed_percent")
    write_json(json_file, {"effects": [dict(zip(keys, row, strict=True)) for row in rows]})
