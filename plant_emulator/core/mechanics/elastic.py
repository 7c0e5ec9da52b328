"""The chain as a mechanism: how stiff and how damped each of its elastic angles is."""

import math

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.layout import JOINTS
from plant_emulator.core.mechanics.bodies import Lump
from plant_emulator.core.mechanics.geometry import Chain, base_tilt, hinges_of
from plant_emulator.core.mechanics.multibody import Mechanism, forward_dynamics, multibody_work

Array = NDArray[np.float64]


def mobility(mechanism: Mechanism, q: Array, coordinates: list[int], held: bool = True) -> Array:
    """The inverse inertia (k, k) of ``coordinates`` at pose ``q`` (n,), without gravity.

    What else turns is ``held``, or is as free as it is.
    """
    n = q.shape[0]
    free = mechanism.free.copy()
    if held:
        free[:] = 0.0
    free[coordinates] = 1.0
    alone, work = mechanism._replace(free=free, gravity=np.zeros(3)), multibody_work(n)
    answer, acceleration = np.zeros((len(coordinates), len(coordinates))), np.zeros(n)
    for k, coordinate in enumerate(coordinates):
        push = np.zeros(n)
        push[coordinate] = 1.0
        forward_dynamics(q, np.zeros(n), push, alone, work, acceleration)
        answer[:, k] = acceleration[coordinates]
    return answer


def outboard_inertia(mechanism: Mechanism, q: Array, coordinate: int) -> float:
    """The inertia (kg m²) behind ``coordinate`` about its axis at pose ``q`` (n,), the others locked."""
    return 1.0 / float(mobility(mechanism, q, [coordinate])[0, 0])


def start_angles(config: PlantConfig, names: tuple[str, ...]) -> Array:
    """The angles (n,) of the chain ``names`` at the start pose, everything elastic straight."""
    q = np.zeros(len(names))
    q[[names.index(joint) for joint in JOINTS]] = np.radians(config.start_pose_deg)
    return q


def _bending(config: PlantConfig) -> list[tuple[list[str], list[float], float]]:
    """The hinges of each beam in each direction: names, stiffnesses (N m/rad), damping ratio."""
    bend, found = config.flexibility, []
    for name, beam, hinges in zip(("boom", "arm"), (bend.boom, bend.arm), hinges_of(config), strict=True):
        for direction, ei in (("vertical", beam.vertical_ei_n_m2), ("lateral", beam.lateral_ei_n_m2)):
            first = f"{name}_{direction}"
            names = [first, *(f"{first}_{k + 1}" for k in range(1, len(hinges)))]
            found.append((names, [ei / hinge.length for hinge in hinges], beam.damping_ratio))
    return found


def _giving(config: PlantConfig) -> list[tuple[list[str], list[float], float]]:
    """What yaws at the pins and twists, as ``_bending`` tells it, whether it is there or not."""
    twist, pin, bend = config.errors.torsion, config.errors.pin_compliance, config.flexibility
    found = []
    for joint, link, gives, beam, gj in (
        ("lift", "boom", pin.lift_nm_rad, bend.boom, twist.boom_gj_n_m2),
        ("tilt", "arm", pin.tilt_nm_rad, bend.arm, twist.arm_gj_n_m2),
    ):
        found.append(([f"{joint}_pin"], [gives], pin.damping_ratio))
        soft = (beam.length_m / gj if twist.enabled else 0.0) + (1.0 / gives if pin.enabled else 0.0)
        ratio = twist.damping_ratio if twist.enabled else pin.damping_ratio
        found.append(([f"{link}_twist"], [1.0 / soft if soft > 0.0 else 0.0], ratio))
    return found


Shared = list[tuple[int, int, float]]
"""Damping between two springs: torque on the first per rate of the second (N m s/rad)."""


def _damp(mechanism: Mechanism, q: Array, indices: list[int], ratio: float) -> Shared:
    """Damp every motion of these springs alone at ``ratio``; what of it two of them share."""
    if len(indices) == 1:
        i = indices[0]
        inertia = outboard_inertia(mechanism, q, i)
        mechanism.damping[i] = 2.0 * ratio * math.sqrt(mechanism.stiffness[i] * inertia)
        return []
    mass = np.linalg.inv(mobility(mechanism, q, indices))
    root = np.linalg.cholesky(0.5 * (mass + mass.T))  # in w = rootᵀ θ the mass is 1
    inverse = np.linalg.inv(root)
    squares, shapes = np.linalg.eigh(inverse @ np.diag(mechanism.stiffness[indices]) @ inverse.T)
    damping = root @ shapes @ np.diag(2.0 * ratio * np.sqrt(squares)) @ shapes.T @ root.T
    mechanism.damping[indices] = np.diag(damping)
    pairs = [(k, m) for k in range(len(indices)) for m in range(len(indices)) if k != m]
    return [(indices[k], indices[m], float(damping[k, m])) for k, m in pairs]


def build_mechanism(config: PlantConfig, chain: Chain, bodies: list[Lump]) -> tuple[Mechanism, Shared]:
    """The true chain with ``bodies``, damped by what lies behind each spring at the start pose."""
    names, n = chain.names, len(chain.names)
    gravity = base_tilt(config)[:3, :3].T @ np.array([0.0, 0.0, -config.gravity_m_s2])
    mechanism = Mechanism(
        axis=chain.axis,
        point=chain.point,
        mass=np.array([body.mass for body in bodies]),
        centre=np.array([body.centre for body in bodies]),
        inertia=np.array([body.inertia for body in bodies]),
        free=np.ones(n),
        stiffness=np.zeros(n),
        damping=np.zeros(n),
        gravity=gravity,
    )
    q = start_angles(config, names)
    bending, shared = _bending(config), []
    for springs, stiffness, ratio in bending + _giving(config):
        if springs[0] in names:
            indices = [names.index(spring) for spring in springs]
            mechanism.stiffness[indices] = stiffness
            shared += _damp(mechanism, q, indices, ratio)
    if not config.flexibility.enabled:
        mechanism.free[[names.index(spring) for springs, _, _ in bending for spring in springs]] = 0.0
    base = config.errors.rocking_base
    for name, frequency in zip(("base_roll", "base_pitch", "base_yaw"), base.frequency_hz, strict=True):
        if name in names:
            i = names.index(name)
            inertia = outboard_inertia(mechanism, q, i)
            mechanism.stiffness[i] = (2.0 * math.pi * frequency) ** 2 * inertia
            _damp(mechanism, q, [i], base.damping_ratio)
    return mechanism, shared
