"""Each source of error has a switch, a provenance and an effect; warm oil drifts as configured."""

from pathlib import Path

import numpy as np
import pytest

from plant_emulator.config.plant import ErrorsConfig
from plant_emulator.core import columns as col
from plant_emulator.core.layout import PRESSURE_A, RATE, TEMPERATURE
from plant_emulator.core.plant import Plant
from plant_emulator.core.right_hand_side import hydraulic_rates, new_work
from protocol.errors import ConfigurationError
from testbed.scenarios.settings import load_settings
from testbed.validation.error_sources import Finding, findings, provenance, sources
from tests.plant_emulator.plant_world import CONFIGS, plant_config

NOMINAL_LENS = {"fx_px": 530.0, "fy_px": 530.0, "cx_px": 639.5, "cy_px": 359.5}
ENCODER_DIGIT_MRAD = 2e3 * np.pi / 2**17
LIFT = 1
WARMER = 20.0


@pytest.fixture(scope="module")
def alone() -> dict[str, Finding]:
    return {finding.name: finding for finding in findings(CONFIGS, NOMINAL_LENS)}


@pytest.mark.slow("a run for every source of error")
def test_every_source_does_something_and_says_where_its_number_comes_from(alone: dict[str, Finding]) -> None:
    assert list(alone) == [source.name for source in sources(NOMINAL_LENS)]
    for finding in alone.values():
        assert abs(finding.value) > 0.0, finding.name
        assert finding.provenance in ("[S]", "[M]", "[E]", "[D]"), finding.name


def test_every_switch_among_the_errors_is_a_source() -> None:
    switched = {name for s in sources(NOMINAL_LENS) for name in s.off.get("plant", {}).get("errors", {})}
    assert switched == set(ErrorsConfig.model_fields)


def test_what_the_sources_do_is_what_their_numbers_say(alone: dict[str, Finding]) -> None:
    settings = load_settings(CONFIGS, {})
    scene, errors = settings.scene, settings.plant.errors
    misplaced = np.subtract(scene.mount.position_m, (-0.2, -0.05, -0.4))
    expected = {
        "encoder offsets": np.linalg.norm(errors.encoder_offsets.mrad),
        "backlash": errors.backlash.half_width_mrad[0],
        "camera mount, position": 1e3 * np.linalg.norm(misplaced),
        "camera mount, rotation": np.linalg.norm(scene.mount.rotation_deg),
        "tool marker, offset": 1e3 * np.linalg.norm(scene.tool_marker.offset_m),
        "tool marker, misalignment": np.linalg.norm(scene.tool_marker.misalignment_deg),
        "print size": 1e3 * scene.tool_marker.side_m * scene.tool_marker.print_scale_error,
        "rectification": np.hypot(0.2, 0.3),
        "picture noise": scene.camera.noise_grey,
    }  # fmt: skip
    for name, value in expected.items():
        digit = ENCODER_DIGIT_MRAD if name == "backlash" else 0.0  # it is read from an encoder
        assert alone[name].value == pytest.approx(value, rel=0.06, abs=0.5 * digit), name
    tilt = np.linalg.norm([errors.base_tilt.x_mrad, errors.base_tilt.y_mrad])
    assert 3.8 * tilt * 0.5 < alone["base tilt"].value < 4.2 * tilt  # of the lever, the part across its axis
    assert 0.3 < alone["encoder noise"].value < 0.6  # and quantisation
    assert alone["valve deadband"].value < alone["friction"].value < 0.0
    assert 2.0 < alone["boom flexibility"].value < 60.0
    torque, rise = 50.0 * 9.81 * 0.3, np.radians([50.0, -25.0])  # of boom and arm at the start pose
    soft = 1.6 / errors.torsion.boom_gj_n_m2, 3.0 / errors.torsion.arm_gj_n_m2
    twisted = 1e3 * torque * abs(np.array(soft) * np.cos(rise) @ np.exp(1j * rise))
    assert alone["torsion"].value == pytest.approx(twisted, rel=0.03)
    assert alone["encoder eccentricity"].value < np.linalg.norm(errors.encoder_eccentricity.mrad)
    play = 0.5 * errors.loose_slew.backlash_mrad
    assert alone["loose slew"].value == pytest.approx(3.89 * play, rel=0.03)


def rates(temperature_degc: float, lift_rate: float = 0.0, push: float = 0.0) -> tuple[float, float, float]:
    """Flow into chamber a, its pressure rate, and friction, of the shut lift cylinder."""
    plant = Plant(plant_config(oil={"air_fraction": 0.0}), seed=1)
    work = new_work(plant._model)
    state = plant._state.copy()
    state[TEMPERATURE] = temperature_degc
    state[RATE + LIFT] = lift_rate
    state[PRESSURE_A + LIFT] += push
    rate = np.zeros_like(state)
    hydraulic_rates(state, np.zeros(6), plant._model, work, rate)
    flow, friction = work.flows[LIFT, [col.F_NET_A, col.F_FRICTION]]
    return float(flow), float(rate[PRESSURE_A + LIFT]), float(friction)


def test_leakage_grows_as_the_oil_thins() -> None:
    oil = plant_config().oil
    cold, warm = rates(oil.reference_degc)[0], rates(oil.reference_degc + WARMER)[0]
    assert cold != 0.0  # across the piston, from the chamber of higher pressure
    assert warm / cold == pytest.approx(np.exp(oil.viscosity_per_k * WARMER), rel=1e-9)


def test_viscous_drag_falls_as_the_oil_thins() -> None:
    config = plant_config()
    piston, reference = config.actuators.lift.cylinder, config.oil.reference_degc
    assert piston is not None
    drag = [rates(t, 0.2)[2] for t in (reference, reference + WARMER)]
    base, lever = piston.base_m, piston.lever_m
    angle = np.radians(config.start_pose_deg[LIFT]) - piston.angle_rad
    length = np.sqrt(base**2 + lever**2 + 2.0 * base * lever * np.cos(angle))
    speed = -0.2 * base * lever * np.sin(angle) / length  # the published linkage, written out once more
    thinner = np.exp(-config.oil.viscosity_per_k * WARMER)
    assert drag[0] - drag[1] == pytest.approx(
        piston.friction.viscous_n_s_m * speed * (1.0 - thinner), rel=1e-9
    )


def test_the_oil_softens_as_it_warms() -> None:
    oil = plant_config().oil
    stiff = []
    for temperature in (oil.reference_degc, oil.reference_degc + WARMER):
        flow, rise, _ = rates(temperature, push=1e5)
        stiff.append(rise / flow)  # β / V
    assert stiff[1] / stiff[0] == pytest.approx(1.0 - oil.modulus_per_k * WARMER, rel=1e-9)


def test_a_key_without_provenance_or_place_is_named(tmp_path: Path) -> None:
    (tmp_path / "plant.yaml").write_text("a:\n  b: 1 # [E] guessed\n  c: 2 # no mark\nd: {e: 3}\n")
    assert provenance(tmp_path, "plant.a.b") == "[E]"
    assert provenance(tmp_path, "plant.a") == "[E]"
    for key, cause in (
        ("plant.a.c", "no_provenance"),
        ("plant.d.e", "no_provenance"),
        ("plant.a.z", "no_such_key"),
    ):
        with pytest.raises(ConfigurationError, match=r"plant\.") as refusal:
            provenance(tmp_path, key)
        assert refusal.value.cause == f"configuration.{cause}"
