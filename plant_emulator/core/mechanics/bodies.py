"""Mass properties of the ten bodies at the home pose, from the parts that plant.yaml lists for each link."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.structure import BeamConfig, PartConfig, WristBodyConfig
from plant_emulator.core.layout import N_COORDINATES
from plant_emulator.core.mechanics.geometry import Chain

Array = NDArray[np.float64]


class Lump(NamedTuple):
    """A rigid body's mass, centre (3,) and inertia about the centre (3, 3), in base axes at home."""

    mass: float
    centre: Array
    inertia: Array


NOTHING = Lump(0.0, np.zeros(3), np.zeros((3, 3)))


def together(lumps: list[Lump]) -> Lump:
    """One rigid body made of ``lumps``, by the parallel-axis theorem."""
    mass = sum(lump.mass for lump in lumps)
    if mass == 0.0:
        return NOTHING
    centre = np.asarray(sum((lump.mass * lump.centre for lump in lumps), np.zeros(3)) / mass)
    inertia = np.zeros((3, 3))
    for lump in lumps:
        d = lump.centre - centre
        inertia += lump.inertia + lump.mass * (float(d @ d) * np.eye(3) - np.outer(d, d))
    return Lump(mass, centre, inertia)


def bar(mass: float, start: Array, end: Array, width: float) -> Lump:
    """A uniform square tube of outer ``width`` from ``start`` to ``end``, its walls thin."""
    span = end - start
    length = float(np.linalg.norm(span))
    direction = span / length if length > 0.0 else np.array([1.0, 0.0, 0.0])
    along = mass * width * width / 3.0
    across = mass * (length * length / 12.0 + width * width / 6.0)
    inertia = across * np.eye(3) + (along - across) * np.outer(direction, direction)
    return Lump(mass, 0.5 * (start + end), inertia)


def sphere(mass: float, centre: Array, radius: float) -> Lump:
    """A homogeneous ball."""
    return Lump(mass, centre, 0.4 * mass * radius * radius * np.eye(3))


def _in_plane(point: tuple[float, float], origin: Array) -> Array:
    return np.asarray(origin + np.array([point[0], 0.0, point[1]]))


def _split(parts: tuple[PartConfig, ...], origin: Array, beam: BeamConfig) -> tuple[Lump, Lump]:
    """The link's parts on the root's side and on the far side of its hinge; a bar across it is cut there."""
    hinge = beam.length_m / 3.0
    root: list[Lump] = []
    far: list[Lump] = []
    for part in parts:
        first, last = sorted((part.from_m, part.to_m))
        a, b = _in_plane(first, origin), _in_plane(last, origin)
        span = last[0] - first[0]
        share = min(max((hinge - first[0]) / span, 0.0), 1.0) if span > 0.0 else float(first[0] < hinge)
        cut = a + share * (b - a)
        root.append(bar(part.mass_kg * share, a, cut, part.width_m))
        far.append(bar(part.mass_kg * (1.0 - share), cut, b, part.width_m))
    return together(root), together(far)


def _moved_out(part: PartConfig, distance: float) -> PartConfig:
    (a, b), (c, d) = part.from_m, part.to_m
    return part.model_copy(update={"from_m": (a + distance, b), "to_m": (c + distance, d)})


def _wrist(body: WristBodyConfig, origin: Array) -> Lump:
    forward, right, down = body.gyration_m
    squares = np.array([forward**2, right**2, down**2])
    return Lump(body.mass_kg, origin + np.array([body.forward_m, 0.0, 0.0]), np.diag(body.mass_kg * squares))


def payload(mass: float, config: PlantConfig, chain: Chain) -> Lump:
    """A load of ``mass`` at the place that the configuration gives it in T axes."""
    centre = chain.X_BT_home[:3, :3] @ np.asarray(config.payload.centre_m) + chain.X_BT_home[:3, 3]
    return sphere(mass, centre, config.payload.radius_m)


def build_bodies(config: PlantConfig, chain: Chain) -> list[Lump]:
    """The ten bodies without payload, where the chain's deviations put them."""
    masses, origin = config.masses, chain.link_origin
    pillar = together(
        [
            bar(p.mass_kg, _in_plane(p.from_m, origin[0]), _in_plane(p.to_m, origin[0]), p.width_m)
            for p in masses.pillar
        ]
    )
    boom_root, boom_far = _split(masses.boom, origin[1], config.flexibility.boom)
    telescope = tuple(_moved_out(part, config.geometry.telescope_m) for part in masses.telescope)
    arm_root, arm_far = _split(masses.arm + telescope, origin[4], config.flexibility.arm)
    wrist = [_wrist(body, origin[7]) for body in (masses.wrist1, masses.wrist2, masses.tool)]
    nominal = [pillar, boom_root, NOTHING, boom_far, arm_root, NOTHING, arm_far, *wrist]
    bodies: list[Lump] = []
    for i in range(N_COORDINATES):
        rotation, shift = chain.deviation[i, :3, :3], chain.deviation[i, :3, 3]
        lump = nominal[i]
        bodies.append(Lump(lump.mass, rotation @ lump.centre + shift, rotation @ lump.inertia @ rotation.T))
    return bodies
