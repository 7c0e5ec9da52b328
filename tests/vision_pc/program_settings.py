"""The programs' settings as shipped, for tests."""

import yaml

from foundation.configuration import load
from nominal_arm.description import NominalArm
from nominal_arm.dimensions import boom_dimensions
from tests.support.paths import CONFIGS
from vision_pc.config.programs import ProgramSettings

BOOM = boom_dimensions(load(NominalArm, CONFIGS / "arm.yaml"))


def shipped() -> ProgramSettings:
    """Section ``programs`` of configs/vision.yaml."""
    return ProgramSettings.model_validate(
        yaml.safe_load((CONFIGS / "vision.yaml").read_text(encoding="utf-8"))["programs"]
    )
