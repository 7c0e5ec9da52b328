"""Families 1 to 3, 11 and 12: geometry, levers, static forces, compliance of oil and beams."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from laboratory.validation.plant_rig import (
    ARM_END,
    CHECK_POSE,
    CHECK_TELESCOPE,
    LIFT,
    TILT,
    Stand,
    ValidationCase,
    default_config,
    loaded_lift,
)
from plant_emulator.core import layout as col
from plant_emulator.core.equilibrium import bent_pose, gravity_torque
from plant_emulator.core.layout import N_COORDINATES, PRESSURE_A, PRESSURE_B, RATE, Q
from plant_emulator.core.mechanics.bodies import sphere
from plant_emulator.core.mechanics.geometry import actuator_lever, actuator_position
from plant_emulator.core.mechanics.multibody import forward_kinematics

Array = NDArray[np.float64]

PUBLISHED = "published model (HIAB XS 031)"
ROD_SIDE = 42e5  # Pa, with which the loaded lift's oil spring is 6.74e6 N/m


def geometry(config_dir: Path) -> list[ValidationCase]:
    """Family 1: piston positions and tip of the published model, and the nominal start pose."""
    stand = Stand(default_config(config_dir, CHECK_TELESCOPE))
    links = [row[: col.A_LENGTH0 + 1] for row in stand.model.actuators]
    wrist = stand.place(9, stand.chain.point[9])
    plain = Stand(default_config(config_dir), np.radians([0.0, 50.0, -75.0, 0.0, -25.0, 0.0]))
    tool = plain.place(9, plain.chain.X_BT_home[:3, 3])
    axes = plain.work.multibody.rotation[-1] @ plain.chain.X_BT_home[:3, :3]
    wanted = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    lift, tilt = CHECK_POSE[1], CHECK_POSE[2]
    return [
        ValidationCase(
            1, "lift piston at 45°", "m", 0.33922, float(actuator_position(lift, *links[1])), 1e-5, PUBLISHED
        ),
        ValidationCase(
            1, "tilt piston at −90°", "m", 0.21757, float(actuator_position(tilt, *links[2])), 1e-5, PUBLISHED
        ),
        ValidationCase(1, "boom tip forward", "m", 2.7445, float(wrist[0]), 5e-5, PUBLISHED),
        ValidationCase(1, "boom tip up", "m", 0.3904, float(wrist[2]), 5e-5, PUBLISHED),
        ValidationCase(
            1, "boom tip, 500 poses", "m", 0.0, _tip_error(stand), 1e-5, f"{PUBLISHED}, closed form"
        ),
        ValidationCase(
            1, "start pose, tool forward", "m", 3.89355, float(tool[0]), 1e-5, "nominal kinematics"
        ),
        ValidationCase(1, "start pose, tool up", "m", 1.00825, float(tool[2]), 1e-5, "nominal kinematics"),
        ValidationCase(
            1,
            "start pose, tool axes",
            "",
            0.0,
            float(np.abs(axes - wanted).max()),
            1e-9,
            "nominal kinematics",
        ),
    ]


def _tip_error(stand: Stand) -> float:
    """The greatest distance (m) of the boom tip from the published closed form, over 500 poses."""
    w, worst, rng = CHECK_TELESCOPE["geometry"]["telescope_m"], 0.0, np.random.default_rng(1)
    for lift, tilt in np.radians(rng.uniform([-9.0, -146.0], [104.0, -19.5], (500, 2))):
        stand.state[[Q + LIFT, Q + TILT]] = lift, tilt
        c1, s1, c12, s12 = np.cos(lift), np.sin(lift), np.cos(lift + tilt), np.sin(lift + tilt)
        x = -0.18926 + 1.59687 * c1 - 0.100002 * s1 + (1.99949 + w) * c12 - 0.15264 * s12
        y = 0.85 + 1.59687 * s1 + 0.100002 * c1 + (1.99949 + w) * s12 + 0.15264 * c12
        place = stand.place(9, stand.chain.point[9])
        worst = max(worst, float(np.linalg.norm(place - [x, 0.0, y])))
    return worst


def levers(config_dir: Path) -> list[ValidationCase]:
    """Family 2: lever arms, and both linkages' slopes against central differences over their whole range."""
    stand = Stand(default_config(config_dir))
    cases = []
    for name, i, angle, expected in (("lift", 1, CHECK_POSE[1], 0.3111), ("tilt", 2, CHECK_POSE[2], 0.3061)):
        link = stand.model.actuators[i, : col.A_LENGTH0 + 1]
        cases.append(
            ValidationCase(
                2, f"{name} lever", "m", expected, float(actuator_lever(angle, *link)), 5e-5, PUBLISHED
            )
        )
        low, high = (-9.0, 104.0) if name == "lift" else (-146.0, -19.5)
        worst = 0.0
        for theta in np.radians(np.linspace(low, high, 200)):
            rise = actuator_position(theta + 1e-6, *link) - actuator_position(theta - 1e-6, *link)
            worst = max(worst, abs(rise / 2e-6 - actuator_lever(theta, *link)))
        cases.append(
            ValidationCase(
                2, f"{name} lever against differences", "m", 0.0, worst, 1e-6, "finite differences"
            )
        )
    return cases


def static_forces(config_dir: Path) -> list[ValidationCase]:
    """Family 3: cylinder forces that hold 570 kg."""
    stand = loaded_lift(config_dir)
    torque = -gravity_torque(stand.model.mechanism, stand.state[Q : Q + N_COORDINATES])
    cases = []
    for name, i, coordinate, angle, expected in (
        ("lift", 1, LIFT, CHECK_POSE[1], 55.5),
        ("tilt", 2, TILT, CHECK_POSE[2], 33.5),
    ):
        lever = actuator_lever(angle, *stand.model.actuators[i, : col.A_LENGTH0 + 1])
        force = float(torque[coordinate]) / lever / 1e3
        cases.append(
            ValidationCase(3, f"{name} holds 570 kg", "kN", expected, force, 0.15, "published load case")
        )
    return cases


def settle_lift(stand: Stand, rod_side: float = ROD_SIDE) -> None:
    """Put the lift, its valve shut, to rest: the bore's pressure carries the load above ``rod_side`` (Pa)."""
    row, mech = stand.model.actuators[1], stand.model.mechanism
    angle = stand.state[Q + LIFT]
    lever = actuator_lever(angle, *row[: col.A_LENGTH0 + 1])
    force = -gravity_torque(mech, stand.state[Q : Q + N_COORDINATES])[LIFT] / lever
    stand.state[PRESSURE_B + 1] = rod_side
    stand.state[PRESSURE_A + 1] = (force + rod_side * row[col.A_AREA_B]) / row[col.A_AREA_A]


def valve_shut_load(config_dir: Path) -> list[ValidationCase]:
    """Family 11: 100 kg more on oil, which the encoder sees, and on the beams, which it does not."""
    stand = loaded_lift(config_dir)
    stand.clamp_all_but(LIFT)
    stand.smooth(1)
    settle_lift(stand)
    end = stand.chain.point[TILT] + np.array([2.49949, 0.0, 0.0])
    row = stand.model.actuators[1]
    before = stand.place(ARM_END, end), actuator_position(stand.state[Q + LIFT], *row[: col.A_LENGTH0 + 1])
    stand.hang(ARM_END, [stand.body(ARM_END), sphere(100.0, end, 0.0)])
    row[col.A_VISCOUS] = 4e5
    stand.run(4.0, 5e-4)
    after = stand.place(ARM_END, end), actuator_position(stand.state[Q + LIFT], *row[: col.A_LENGTH0 + 1])
    piston, tip = (after[1] - before[1]) * 1e3, float(after[0][2] - before[0][2]) * 1e3
    drop, turned = _beam_drop(config_dir)
    source = "linear oil spring of 6.74e6 N/m; geometry adds 2 % of stiffness"
    return [
        ValidationCase(11, "piston under 100 kg more", "mm", -1.32, float(piston), 0.03, source),
        ValidationCase(11, "tip under 100 kg more", "mm", -12.0, tip, 0.3, source),
        ValidationCase(11, "at rest again", "rad/s", 0.0, abs(float(stand.state[RATE + LIFT])), 1e-6, "rest"),
        ValidationCase(
            11, "tip bends under 100 kg", "mm", drop[0], drop[1], 0.01 * abs(drop[0]), "Euler-Bernoulli"
        ),
        ValidationCase(
            11, "encoders while the beams bend", "rad", 0.0, turned, 1e-12, "hinges lie behind the encoders"
        ),
    ]


def _beam_drop(config_dir: Path) -> tuple[tuple[float, float], float]:
    """Expected and obtained tip drop (mm) of the locked arm under 100 kg, and how far the joints turned."""
    stand = loaded_lift(config_dir, 0.0)
    mech, q = stand.model.mechanism, stand.state[Q : Q + N_COORDINATES].copy()
    end = stand.chain.point[TILT] + np.array([2.49949, 0.0, 0.0])
    heights, poses = [], []
    for extra in (0.0, 100.0):
        stand.hang(ARM_END, [stand.body(ARM_END), sphere(extra, end, 0.0)])
        poses.append(bent_pose(stand.model, q))
        stand.state[Q : Q + N_COORDINATES] = poses[-1]
        heights.append(float(stand.place(ARM_END, end)[2]))
    stand.state[Q : Q + N_COORDINATES] = q
    tip, weight, expected = stand.place(ARM_END, end), 100.0 * stand.config.gravity_m_s2, 0.0
    work = stand.work.multibody
    forward_kinematics(q, mech, work)
    for hinge in (2, 5):
        reach = float(tip[0] - (work.rotation[hinge] @ mech.point[hinge] + work.origin[hinge])[0])
        expected -= weight * reach * reach / float(mech.stiffness[hinge])
    joints = [0, 1, 4, 7, 8, 9]
    turned = float(np.abs(poses[1][joints] - poses[0][joints]).max())
    return (expected * 1e3, (heights[1] - heights[0]) * 1e3), turned


def cantilevers(config_dir: Path) -> list[ValidationCase]:
    """Family 12: tip deflection and slope of both boxes under 1 kN, against Euler and Bernoulli."""
    boom = Stand(default_config(config_dir, {"flexibility": {"arm": {"length_m": 2.0}}}), np.zeros(6))
    along = boom.chain.point[TILT] - boom.chain.point[LIFT]
    level = np.array([0.0, -np.arctan2(along[2], along[0]), 0.0, 0.0, 0.0, 0.0])
    cases = []
    for name, body, point, expected, pose, hinge in (
        ("box 150×6 of 1.6 m", 3, boom.chain.point[TILT], 0.543, level, 2),
        ("box 100×6 of 2 m", 6, boom.chain.point[TILT] + np.array([2.0, 0.0, 0.0]), 3.81, np.zeros(6), 5),
    ):
        stand = Stand(boom.config, pose)
        stand.unload(*range(N_COORDINATES))
        stand.clamp_all_but(hinge)
        stand.hang(body, [sphere(1000.0 / stand.config.gravity_m_s2, point, 0.0)])
        straight = stand.place(body, point)
        bent = bent_pose(stand.model, stand.angles)
        stand.state[Q : Q + N_COORDINATES] = bent
        drop = float(straight[2] - stand.place(body, point)[2]) * 1e3
        beam = stand.config.flexibility.boom if hinge == 2 else stand.config.flexibility.arm
        slope = 1000.0 * beam.length_m**2 / (2.0 * beam.vertical_ei_n_m2) * 1e3
        cases.append(
            ValidationCase(
                12, f"{name}, tip under 1 kN", "mm", expected, drop, 0.002 * expected, "P L³ / 3 EI"
            )
        )
        cases.append(
            ValidationCase(
                12,
                f"{name}, slope under 1 kN",
                "mrad",
                slope,
                -float(bent[hinge]) * 1e3,
                0.002 * slope,
                "P L² / 2 EI",
            )
        )
    return cases
