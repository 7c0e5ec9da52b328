"""What is derived from arm.yaml, against the controller's kinematics on random arms and joint angles."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.core.kinematics.denavit_hartenberg import chain, dh_table
from foundation.configuration import load, validated
from nominal_arm.description import NominalArm
from nominal_arm.dimensions import boom_dimensions, dh_links
from tests.support.paths import CONFIGS

SHIPPED = load(NominalArm, CONFIGS / "arm.yaml")
LENGTHS = {"a_m": (0, 1, 2), "d_m": (0, 3, 5)}  # rows in which Table 1 has a length
Angles = st.tuples(*[st.floats(-math.pi, math.pi)] * 6).map(np.array)


@st.composite
def arms(draw: st.DrawFn) -> NominalArm:
    """Any arm of Table 1's structure: lengths of either sign, offsets of any angle but the mock link's."""
    document: dict[str, Any] = SHIPPED.model_dump(mode="json")
    for key, rows in LENGTHS.items():
        for row in rows:
            document["dh"][row][key] = draw(st.floats(-10.0, 10.0))
    for row in range(6):
        document["dh"][row]["theta_offset_deg"] = draw(st.floats(-360.0, 360.0))
    return validated(NominalArm, document, "drawn")


@given(arms(), Angles)
@settings(deadline=None)  # the first example loads compiled code
def test_the_lengths_are_those_of_the_controllers_frames(arm: NominalArm, q: np.ndarray) -> None:
    frames = chain(dh_table(arm.dh), q)
    slewed, lifted, wrist, tool = (frames[k] for k in (1, 2, 4, 7))
    boom = boom_dimensions(arm)
    slew = q[0] + math.radians(arm.dh[0].theta_offset_deg)
    forward = np.array([math.cos(slew), math.sin(slew), 0.0])
    lift_pivot = boom.lift_pivot[0] * forward + np.array([0.0, 0.0, boom.lift_pivot[1]])
    assert slewed[:, 3] == pytest.approx(lift_pivot, abs=1e-12)
    assert math.dist(lifted[:, 3], slewed[:, 3]) == pytest.approx(boom.boom, abs=1e-12)
    assert math.dist(wrist[:, 3], lifted[:, 3]) == pytest.approx(boom.forearm, abs=1e-12)
    assert tool[:, 3] - boom.wrist_to_tool * tool[:, 2] == pytest.approx(wrist[:, 3], abs=1e-12)
    # lift, tilt and wrist stay in the slewing plane: one angle of the wrist's centre tells the slew
    across = np.array([-math.sin(slew), math.cos(slew), 0.0])
    assert [across @ frame[:, 3] for frame in (slewed, lifted, wrist)] == pytest.approx([0.0] * 3, abs=1e-12)


@given(arms())
def test_the_links_are_the_controllers_table(arm: NominalArm) -> None:
    assert np.array_equal(np.array(dh_links(arm)), dh_table(arm.dh))


@pytest.mark.parametrize(
    ("name", "boom", "forearm"), [("arm.yaml", 1.6, 3.00337), ("arms/long_crane/arm.yaml", 3.20624, 6.20322)]
)
def test_shipped_arms(name: str, boom: float, forearm: float) -> None:
    derived = boom_dimensions(load(NominalArm, CONFIGS / name))
    assert (derived.boom, derived.forearm) == pytest.approx((boom, forearm), abs=6e-6)
    assert derived.wrist_to_tool == 0.35
