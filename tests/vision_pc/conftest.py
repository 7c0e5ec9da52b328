"""What the vision tests share: the shipped configuration, its camera, and a seeded generator."""

from pathlib import Path

import numpy as np
import pytest

from foundation.configuration import load
from vision_pc.config.vision import VisionConfig
from vision_pc.core.perception import intrinsics
from vision_pc.core.types import CameraCalibration

VISION_YAML = Path(__file__).resolve().parents[2] / "configs" / "vision.yaml"


@pytest.fixture(scope="session")
def config() -> VisionConfig:
    return load(VisionConfig, VISION_YAML)


@pytest.fixture(scope="session")
def camera(config: VisionConfig) -> CameraCalibration:
    return intrinsics.calibration(config.camera)


@pytest.fixture
def generator() -> np.random.Generator:
    return np.random.default_rng(20230517)
