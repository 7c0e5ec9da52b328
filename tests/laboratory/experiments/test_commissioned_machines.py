"""One joint of a drawn machine, as the campaign of commissioning tries it out."""

import pytest

from laboratory.experiments.robustness.commissioning import commission_joint
from tests.support.paths import CONFIGS

pytestmark = [pytest.mark.slow("a joint is commissioned"), pytest.mark.timeout(600)]


def test_a_boom_that_swings_on_its_load_holding_valve_is_tried_out() -> None:
    """Machine 41871's lift: a swing had told a rim 0.08 too low, and ramps fell too quickly to be read."""
    found = commission_joint(CONFIGS, {"key": "41871-lift", "seed": 41871, "joint": 1})
    assert abs(found["raising_percent"]) < 1.0
    assert abs(found["lowering_percent"]) < 5.0
    assert abs(found["lowering_z"]) < 2.0
    assert abs(found["play_percent"]) < 5.0
