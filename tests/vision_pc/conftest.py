"""What the vision tests share: the shipped configuration, its camera, and a seeded generator."""

import numpy as np
import pytest

from foundation.configuration import load
from tests.support.paths import CONFIGS
from vision_pc.config.vision import VisionConfig
from vision_pc.core.perception import intrinsics
from vision_pc.core.types import CameraCalibration

VISION_YAML = CONFIGS / "vision.yaml"


@pytest.fixture(scope="session")
def config() -> VisionConfig:
    return load(VisionConfig, VISION_YAML)


@pytest.fixture(scope="session")
def camera(config: VisionConfig) -> CameraCalibration:
    return intrinsics.calibration(config.camera)


@pytest.fixture
def generator() -> np.random.Generator:
    return np.random.default_rng(20230517)
