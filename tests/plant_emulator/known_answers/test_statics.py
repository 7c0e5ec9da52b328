"""Geometry, levers, static forces, compliance of oil and beams. Numbers without a formula are published
(HIAB XS 031)."""

import math

import numpy as np
import pytest

from plant_emulator.core import layout as col
from plant_emulator.core.equilibrium import bent_pose, gravity_torque, standing_torque
from plant_emulator.core.layout import N_COORDINATES, PRESSURE_A, PRESSURE_B, RATE, Q
from plant_emulator.core.mechanics.bodies import sphere
from plant_emulator.core.mechanics.geometry import actuator_lever, actuator_position
from tests.plant_emulator.known_answers.stand import (
    CHECK_POSE,
    CHECK_TELESCOPE,
    LIFT,
    LIFT_VALVE,
    START,
    TILT,
    TILT_VALVE,
    Stand,
    default_config,
    loaded_lift,
    shut_lift,
    switched_on,
)

NEWTONS = 1000.0


def link_of(stand: Stand, actuator: int) -> np.ndarray:
    return np.asarray(stand.model.actuators[actuator, : col.A_LENGTH0 + 1])


def test_pistons_and_boom_tip_are_where_the_published_model_has_them() -> None:
    stand, w = Stand(default_config(CHECK_TELESCOPE)), 0.5
    assert actuator_position(CHECK_POSE[1], *link_of(stand, LIFT_VALVE)) == pytest.approx(0.33922, abs=1e-5)
    assert actuator_position(CHECK_POSE[2], *link_of(stand, TILT_VALVE)) == pytest.approx(0.21757, abs=1e-5)
    tip = stand.place(9, stand.chain.point[9])
    assert (tip[0], tip[2]) == pytest.approx((2.7445, 0.3904), abs=5e-5)
    for lift, tilt in np.radians(np.random.default_rng(1).uniform([-9, -146], [104, -19.5], (500, 2))):
        stand.state[[Q + LIFT, Q + TILT]] = lift, tilt
        c1, s1, c12, s12 = np.cos(lift), np.sin(lift), np.cos(lift + tilt), np.sin(lift + tilt)
        x = -0.18926 + 1.59687 * c1 - 0.100002 * s1 + (1.99949 + w) * c12 - 0.15264 * s12
        y = 0.85 + 1.59687 * s1 + 0.100002 * c1 + (1.99949 + w) * s12 + 0.15264 * c12
        assert stand.place(9, stand.chain.point[9]) == pytest.approx([x, 0.0, y], abs=1e-5)


@pytest.mark.parametrize(
    ("valve", "pose", "lever_m", "low", "high"),
    [(LIFT_VALVE, CHECK_POSE[1], 0.3111, -9, 104), (TILT_VALVE, CHECK_POSE[2], 0.3061, -146, -19.5)],
)
def test_a_lever_is_the_pistons_way_over_the_angle(
    valve: int, pose: float, lever_m: float, low: float, high: float
) -> None:
    link = link_of(Stand(default_config()), valve)
    assert actuator_lever(pose, *link) == pytest.approx(lever_m, abs=5e-5)
    for angle in np.radians(np.linspace(low, high, 200)):
        rise = actuator_position(angle + 1e-6, *link) - actuator_position(angle - 1e-6, *link)
        assert rise / 2e-6 == pytest.approx(actuator_lever(angle, *link), abs=1e-6)


@pytest.mark.parametrize(("valve", "at", "kn"), [(LIFT_VALVE, LIFT, 55.5), (TILT_VALVE, TILT, 33.5)])
def test_cylinders_hold_570_kg_with_the_published_forces(valve: int, at: int, kn: float) -> None:
    stand = loaded_lift()
    torque = -gravity_torque(stand.model.mechanism, stand.state[Q : Q + N_COORDINATES])[at]
    lever = actuator_lever(CHECK_POSE[valve], *link_of(stand, valve))
    assert torque / lever / 1e3 == pytest.approx(kn, abs=0.15)


def test_the_oil_spring_of_the_shut_lift_is_that_of_two_columns() -> None:
    """β (A_a²/V_a + A_b²/V_b) = 6.74 MN/m."""
    stand = shut_lift()
    stand.state[RATE + LIFT] = 1e-6
    rate, row = stand.rates(), stand.model.actuators[LIFT_VALVE]
    force = row[col.A_AREA_A] * rate[PRESSURE_A + LIFT_VALVE]
    force -= row[col.A_AREA_B] * rate[PRESSURE_B + LIFT_VALVE]
    assert -force / stand.work.flows[LIFT_VALVE, col.F_VELOCITY] / 1e6 == pytest.approx(6.74, abs=0.02)


@pytest.mark.parametrize("hinges", [None, [0.25, 0.6], [0.28, 0.6], [0.2, 0.5, 0.8]], ids=str)
@pytest.mark.parametrize(("beam", "pivot", "next_one"), [("boom", "lift", "tilt"), ("arm", "tilt", "wrist1")])
def test_a_level_beam_bends_under_1_kn_as_euler_and_bernoulli_say(
    hinges: list[float] | None, beam: str, pivot: str, next_one: str
) -> None:
    """Tip: P L³ / 3 EI; slope: P L² / 2 EI."""
    finer = {} if hinges is None else switched_on(finer_bending={"boom_at": hinges, "arm_at": hinges})
    stand = Stand(default_config(finer), np.zeros(6))
    box = getattr(stand.config.flexibility, beam)
    vertical = [i for i, name in enumerate(stand.chain.names) if name.startswith(f"{beam}_vertical")]
    root, end = (stand.chain.point[stand.at(name)] for name in (pivot, next_one))
    tip = root + (end - root) * (box.length_m / np.linalg.norm(end - root))
    stand.unload(*range(len(stand.angles)))
    stand.clamp_all_but(*vertical)
    stand.hang(vertical[-1] + 1, [sphere(NEWTONS / stand.config.gravity_m_s2, tip, 0.0)])
    level = stand.angles
    level[stand.at(pivot)] = -math.atan2(tip[2] - root[2], tip[0] - root[0])
    stand.state[stand.model.places.angle] = level
    before = stand.place(vertical[-1] + 1, tip)[2]
    bent = bent_pose(stand.model, level)
    stand.state[stand.model.places.angle] = bent
    drop = before - stand.place(vertical[-1] + 1, tip)[2]
    length, soft = box.length_m, NEWTONS / box.vertical_ei_n_m2
    assert drop == pytest.approx(soft * length**3 / 3.0, rel=2e-3)
    assert -bent[vertical].sum() == pytest.approx(soft * length**2 / 2.0, rel=2e-3)


@pytest.mark.parametrize("pins", [False, True], ids=["alone", "on its pin"])
@pytest.mark.parametrize("beam", ["boom", "arm"])
def test_a_load_beside_the_axis_twists_a_link(beam: str, pins: bool) -> None:
    """m g y (L / GJ + 1 / K of the pin)."""
    entries = ("torsion", "pin_compliance") if pins else ("torsion",)
    stand = Stand(default_config(switched_on(*entries)), np.zeros(6))
    errors, joint = stand.config.errors, "lift" if beam == "boom" else "tilt"
    soft = getattr(stand.config.flexibility, beam).length_m / getattr(errors.torsion, f"{beam}_gj_n_m2")
    soft += 1.0 / getattr(errors.pin_compliance, f"{joint}_nm_rad") if pins else 0.0
    at, q = stand.at(f"{beam}_twist"), stand.angles
    axis, root = stand.chain.axis[at], stand.chain.point[at]
    q[stand.at(joint)] = -math.atan2(axis[2], axis[0])
    stand.unload(*range(len(q)))
    stand.clamp_all_but(at)
    stand.hang(at, [sphere(100.0, root + axis + np.array([0.0, -0.3, 0.0]), 0.0)])
    torque = 100.0 * stand.config.gravity_m_s2 * 0.3
    assert bent_pose(stand.model, q)[at] == pytest.approx(torque * soft, abs=3e-7)


def test_the_slewing_ring_leans_forward_by_its_clearance_and_its_spring() -> None:
    """Clearance / 2 D + M / K."""
    stand = Stand(default_config(switched_on("bearing_tilt")), START)
    ring, at = stand.config.errors.bearing_tilt, stand.at("ring_roll")
    bent = bent_pose(stand.model, stand.angles)
    moment = float(np.linalg.norm(standing_torque(stand.model, bent)[[at, at + 1]]))
    expected = 0.5e-3 * ring.play_mm / ring.diameter_m + moment / ring.stiffness_nm_rad
    assert np.hypot(*bent[[at, at + 1]]) == pytest.approx(expected, abs=1e-9)
    assert bent[at + 1] == pytest.approx(expected, abs=2e-5)
