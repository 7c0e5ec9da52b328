"""The programs' settings as shipped, for tests."""

from pathlib import Path

import yaml

from vision_pc.config.programs import ProgramSettings

CONFIG = Path(__file__).parents[2] / "configs" / "vision.yaml"


def shipped() -> ProgramSettings:
    """Section ``programs`` of configs/vision.yaml."""
    return ProgramSettings.model_validate(yaml.safe_load(CONFIG.read_text(encoding="utf-8"))["programs"])
