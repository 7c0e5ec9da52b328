"""A machine that nobody knows, commissioned: one look ends inside; before, its slew counts as stuck."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from foundation.configuration import parse_overrides
from laboratory.experiments.positioning.corrected_run import operate, prepared, true_error_mm
from nominal_arm.commissioned import Commissioned
from testbed.commissioning.command import CommissionRequest, run_commission
from tests.support.paths import CONFIGS

pytestmark = pytest.mark.timeout(600)  # a minute of arm time and a look, on a busy machine

SEED = 3
MACHINE = (
    "plant.valves.joints.slew.deadband=0.03",  # 0.005 is believed
    "controller.cycle_ms=10",
    "controller.excitation.ramps=2",
)


def one_look_mm(*assignments: str) -> float:
    """The true error after one look and its corrected motion, worse of x and y."""
    run = {"seed": SEED, "arm": "plant", "world": "lab", "eyes": "model", "assignments": [*assignments]}
    rig = prepared(CONFIGS, run)
    operate(rig, "look-then-move", {"method": "corrected", "aim_mm": 0.0})
    return float(np.abs(true_error_mm(rig)[:2]).max())


@pytest.mark.slow("a minute of arm time and a look")
def test_a_commissioned_machine_ends_inside(tmp_path: Path) -> None:
    request = CommissionRequest(CONFIGS, parse_overrides(list(MACHINE)), ["slew"], tmp_path, 1, None)
    assert run_commission(request)
    found = Commissioned.model_validate(yaml.safe_load((tmp_path / "commissioned.yaml").read_text()))
    for edge in (found.valves.slew.raising, found.valves.slew.lowering):
        assert edge.deadband.value == pytest.approx(0.03, rel=0.05)
        assert abs(edge.deadband.value - 0.03) < 4.0 * edge.deadband.std
    assert one_look_mm(*MACHINE, f"controller.commissioned={tmp_path / 'commissioned.yaml'}") < 2.0
