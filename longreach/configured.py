"""The configuration of a rig or part, chosen as on the command line."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from foundation.command_options import usual_configs
from testbed.scenarios.arms import arm_directory
from testbed.scenarios.settings import Settings, chosen_overrides, load_settings

CONFIGS = usual_configs()  # as the command line's --config-dir
Assignments = Mapping[str, Any]
"""As ``--set``: ``{"plant.payload.mass_kg": 80}``."""


def configured(
    config_dir: Path | str, arm: str | None, scenario: str | None, seed: int, set: Assignments | None
) -> Settings:
    """Every file of ``config_dir``, or of an arm in it, with a scenario's world and the assignments over it.

    Raises ConfigurationError.
    """
    assignments = [f"{key}={json.dumps(value)}" for key, value in (set or {}).items()]
    folder = Path(config_dir) if arm is None else arm_directory(Path(config_dir), arm)
    return load_settings(folder, chosen_overrides(folder, scenario, seed, assignments))
