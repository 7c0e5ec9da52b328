"""Fifth stage: the fitted plant as a file that the emulator loads, each fitted number with its source."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from foundation.configuration import load
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.plant import Plant
from protocol.errors import ConfigurationError
from testbed.identification.findings import FittedNumber, findings
from testbed.identification.fit import Identified
from testbed.identification.parameters import Key, changed
from testbed.identification.recording import MotionRecording


def write_plant_file(
    path: Path, found: Identified, config: PlantConfig, recording: MotionRecording, sure: bool = True
) -> PlantConfig:
    """Write ``config`` with what was fitted in it to ``path``; the plant that loads from there.

    A parameter that the recording does not tell keeps the file's number. Not ``sure``: σ do not hold, and are
    not written. Raises ConfigurationError when the
    file cannot be written.
    """
    told = {finding.name: finding for finding in findings(found)}
    pairs = zip(found.problem.parameters, found.whole.theta, strict=True)
    machine = [(p, theta) for p, theta in pairs if not p.of_start]
    data = changed(found.problem.base, [p for p, _ in machine], np.array([theta for _, theta in machine]))
    data["step_ms"] = _step_ms(data, config.step_ms)
    notes = {
        key: _provenance(told[p.name], recording, sure)
        for p, _ in machine
        if not told[p.name].kept
        for key in p.keys
    }
    lines = [
        f"# Identified from a recording of '{recording.about.arm}', sha256 {recording.sha256}.",
        f"# [I {'±σ' if sure else 'σ unknown'}, recording]: fitted to it."
        " All else is as in the plant file that the fit began with.",
        *_lines(data, (), notes),
    ]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigurationError("output.unwritable", f"{path}: {error.strerror}") from error
    return load(PlantConfig, path)


def _step_ms(data: dict[str, Any], wished: float) -> float:
    """``wished`` where the plant of ``data`` is stable with it, else the step that it was fitted with."""
    try:
        Plant(PlantConfig.model_validate(data | {"step_ms": wished}), seed=0)
    except (ConfigurationError, ValueError):
        return float(data["step_ms"])
    return wished


def _provenance(finding: FittedNumber, recording: MotionRecording, sure: bool) -> str:
    spread = f"{finding.percent:.2g} %" if finding.percent < 100.0 else f"{finding.std:.2g} {finding.unit}"
    told = f"±{spread}" if sure else "σ unknown"
    return f"[I {told}, recording {recording.sha256[:12]}]"


def _lines(data: Any, path: Key, notes: dict[Key, str], depth: int = 0) -> list[str]:
    """``data`` as YAML in blocks, a note behind each entry that has one; '*' is any place in a list."""
    found: list[str] = []
    pad = "  " * depth
    for name, item in data.items():
        here = (*path, name)
        if isinstance(item, dict) and item:
            found += [f"{pad}{name}:", *_lines(item, here, notes, depth + 1)]
        elif isinstance(item, list) and item and isinstance(item[0], dict):
            found.append(f"{pad}{name}:")
            for entry in item:
                first, *rest = _lines(entry, (*here, "*"), notes, depth + 2)
                found += [f"{pad}  - {first.strip()}", *rest]
        else:
            note = notes.get(here) or next((n for k, n in notes.items() if k[: len(here)] == here), "")
            text = yaml.safe_dump(item, default_flow_style=True, width=1 << 20).removesuffix("...\n").strip()
            found.append(f"{pad}{name}: {text}" + (f" # {note}" if note else ""))
    return found
