"""`longreach camera loop`: the best mode through raw pairs and their file, beside perfect pairs."""

import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from protocol.errors import RequestRefused
from testbed.experiments.positioning.corrected_run import Branch, one_run
from testbed.reporting.console import bars, out, table, write_json
from testbed.scenarios.scenario import flattened
from testbed.scenarios.settings import chosen_overrides, load_settings
from vision_pc.config.camera_files.reading import read_calibration
from vision_pc.config.stereo_camera import StereoCalibration
from vision_pc.core.perception.rectification import Rectifier, rectified_camera
from vision_pc.core.types import StereoPair

_ALLOWED = 1.2  # of the errors with perfect rectification
_ROUNDS = 20
_STRAIGHT = dict.fromkeys(("k1", "k2", "p1", "p2", "k3"), 0.0)


class LoopRow(NamedTuple):
    """One seed: the worse of true |x| and |y| after one look, mm, with raw pairs and with perfect ones."""

    seed: int
    raw_mm: float
    perfect_mm: float
    failure: str = ""


def run_loop(config_dir: Path, file: Path, runs: int, seed: int, json_file: Path | None) -> bool:
    """Print each seed's errors. Returns whether those with raw pairs are at most 1.2 times the perfect ones.

    Raises ConfigurationError for the file, RequestRefused where it is not of the scenario ``raw_camera``.
    """
    scene = load_settings(config_dir, chosen_overrides(config_dir, "raw_camera", seed, [])).scene.camera
    found = read_calibration(file, (scene.width_px, scene.height_px))
    if abs(found.right_position_m[0] / scene.baseline_m - 1.0) > 0.05:
        raise RequestRefused(
            "refused.camera.another",
            f"{file}: baseline {1e3 * found.right_position_m[0]:.1f} mm, the scenario raw_camera has "
            f"{1e3 * scene.baseline_m:.1f} mm: calibrate pairs of longreach camera emulate",
        )
    keys = ("baseline_m", "lens", "lens_difference", "rectification")
    raw = {"scene": {"camera": {key: scene.model_dump()[key] for key in keys}},
           "vision": {"camera": {"calibration": str(file.resolve())}}}  # fmt: skip
    rows = []
    with bars() as shown, shown.step("driving") as bar:
        for k in range(runs):
            rows.append(_row(config_dir, seed + k, flattened(raw), flattened(_perfect(found))))
            bar.update((k + 1) / runs, f"seed {seed + k}")
    return _printed(rows, found, json_file)


def _perfect(found: StereoCalibration) -> dict[str, Any]:
    """A camera whose pairs are rectified exactly, and vision told exactly."""
    camera = rectified_camera(found)
    K = camera.left.K
    eye = {"fx_px": K[0, 0], "fy_px": K[1, 1], "cx_px": K[0, 2], "cy_px": K[1, 2]}
    eye = {name: float(value) for name, value in eye.items()}
    baseline = float(camera.right.X_CE[0, 3])
    true = {
        "baseline_m": baseline,
        "lens": eye | _STRAIGHT,
        "lens_difference": dict.fromkeys(eye, 0.0) | _STRAIGHT,
        "rectification": {"vertical_px": 0.0, "disparity_px": 0.0, "right_eye_rotation_deg": [0.0, 0.0, 0.0]},
    }
    told = {"left": eye, "right": eye, "baseline_m": baseline}
    return {"scene": {"camera": true}, "vision": {"camera": {"calibration": told}}}


def _row(config_dir: Path, seed: int, raw: list[str], perfect: list[str]) -> LoopRow:
    errors, failure = [], ""
    for assignments in (raw, perfect):
        task = {"seed": seed, "arm": "plant", "world": "lab", "eyes": "pixels", "assignments": assignments}
        row = one_run(config_dir, task)
        branch = row.get("look1", Branch(failure=str(row.get("failure", ""))))
        failure = failure or branch.failure
        errors.append(branch.worst_mm)
    return LoopRow(seed, errors[0], errors[1], failure)


def _printed(rows: list[LoopRow], found: StereoCalibration, json_file: Path | None) -> bool:
    cells = [[row.seed, f"{row.raw_mm:.2f}", f"{row.perfect_mm:.2f}", row.failure] for row in rows]
    headings = ("seed", "raw pairs", "perfectly rectified", "failure")
    out.print(table("worse of true |x| and |y| after one look, mm", headings, cells))
    raw = float(np.median([row.raw_mm for row in rows]))
    perfect = float(np.median([row.perfect_mm for row in rows]))
    good = raw <= _ALLOWED * perfect
    spent_ms = _spent_ms(found)
    out.print(
        f"median {raw:.2f} mm with raw pairs, {perfect:.2f} mm with perfect ones: {raw / perfect:.2f} times, "
        f"{'reached' if good else 'MISSED'} (at most {_ALLOWED:g}); "
        f"rectifying takes {spent_ms:.1f} ms of CPU a pair",
        highlight=False,
        soft_wrap=True,
    )
    write_json(json_file, {"rows": rows, "raw_mm": raw, "perfect_mm": perfect, "rectifying_ms": spent_ms})
    return good


def _spent_ms(found: StereoCalibration) -> float:
    """Processor time for one pair, the least of 20 rounds."""
    grey = np.random.default_rng(1).integers(0, 255, (2, found.height_px, found.width_px), dtype=np.uint8)
    rectify, spent = Rectifier(found), []
    for _ in range(_ROUNDS):
        begin = time.thread_time()
        rectify(StereoPair(grey[0], grey[1], 0, 0))
        spent.append(time.thread_time() - begin)
    return 1e3 * min(spent)
