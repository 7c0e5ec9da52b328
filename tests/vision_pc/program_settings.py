"""The programs' settings as shipped, for tests."""

import yaml

from tests.support.paths import CONFIGS
from vision_pc.config.programs import ProgramSettings


def shipped() -> ProgramSettings:
    """Section ``programs`` of configs/vision.yaml."""
    return ProgramSettings.model_validate(
        yaml.safe_load((CONFIGS / "vision.yaml").read_text(encoding="utf-8"))["programs"]
    )
