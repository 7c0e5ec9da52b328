"""``plc/constants.st``, made from the shipped configuration; ``python -m tools.plc_constants`` writes it."""

from controller.config import ControllerConfig
from controller_st.constants import constants_text
from foundation.configuration import load
from nominal_arm.description import NominalArm
from tools.protocol_page import ROOT

FILE = ROOT / "plc" / "constants.st"


def text() -> str:
    """What the file says."""
    configs = ROOT / "configs"
    return constants_text(
        load(NominalArm, configs / "arm.yaml"), load(ControllerConfig, configs / "controller.yaml")
    )


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")
