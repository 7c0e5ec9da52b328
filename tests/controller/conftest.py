"""The configuration files as shipped, read once."""

import numpy as np
import pytest

from controller.config import ControllerConfig
from controller.core.kinematics.denavit_hartenberg import dh_table
from controller.core.kinematics.rotations import Array
from controller.core.settings import ScanSettings, settings_from
from foundation.configuration import load
from nominal_arm.description import NominalArm
from tests.support.paths import CONFIGS


@pytest.fixture(scope="session")
def arm() -> NominalArm:
    return load(NominalArm, CONFIGS / "arm.yaml")


@pytest.fixture(scope="session")
def config() -> ControllerConfig:
    return load(ControllerConfig, CONFIGS / "controller.yaml")


@pytest.fixture(scope="session")
def settings(arm: NominalArm, config: ControllerConfig) -> ScanSettings:
    return settings_from(arm, config)


@pytest.fixture(scope="session")
def table(arm: NominalArm) -> Array:
    return dh_table(arm.dh)


@pytest.fixture(scope="session")
def joint_range(arm: NominalArm) -> tuple[Array, Array]:
    lower = np.radians([joint.lower_deg for joint in arm.joints])
    return lower, np.radians([joint.upper_deg for joint in arm.joints])
