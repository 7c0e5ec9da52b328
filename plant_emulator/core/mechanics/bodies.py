"""Mass properties of the bodies at the home pose, from the parts that plant.yaml lists for each link."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.structure import PartConfig, WristBodyConfig
from plant_emulator.core.mechanics.geometry import Chain, Hinge, hinges_of

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


def _lumps_between(parts: tuple[PartConfig, ...], origin: Array, hinges: list[Hinge]) -> list[Lump]:
    """The link's parts as the bodies between its hinges, root first; a bar across a hinge is cut there."""
    places = [hinge.along for hinge in hinges]
    found: list[list[Lump]] = [[] for _ in range(len(places) + 1)]
    for part in parts:
        first, last = sorted((part.from_m, part.to_m))
        a, b = _in_plane(first, origin), _in_plane(last, origin)
        span = last[0] - first[0]
        start, done = a, 0.0
        for k, place in enumerate(places):
            share = min(max((place - first[0]) / span, 0.0), 1.0) if span > 0.0 else float(first[0] < place)
            cut = a + share * (b - a)
            found[k].append(bar(part.mass_kg * (share - done), start, cut, part.width_m))
            start, done = cut, share
        found[-1].append(bar(part.mass_kg * (1.0 - done), start, b, part.width_m))
    return [together(lumps) for lumps in found]


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


def _segments(name: str, joint: str, names: tuple[str, ...], cut: list[Lump]) -> dict[str, Lump]:
    """Which coordinate each body of a link stands behind: the root behind its joint, pin and twist."""
    root = [n for n in (joint, f"{joint}_pin", f"{name}_twist") if n in names][-1]
    lateral = [n for n in names if n.startswith(f"{name}_lateral")]
    return dict(zip([root, *lateral], cut, strict=True))


def _foot(config: PlantConfig, names: tuple[str, ...]) -> dict[str, Lump]:
    """The pillar behind whatever of the slew is there, what turns before its play, and the carrier."""
    errors = config.errors
    pillar = together(
        [
            bar(p.mass_kg, _in_plane(p.from_m, np.zeros(3)), _in_plane(p.to_m, np.zeros(3)), p.width_m)
            for p in config.masses.pillar
        ]
    )
    found = {}
    if errors.loose_slew.enabled:  # a flat disc on the slew's axis
        turning = errors.loose_slew.motor_side_kg_m2
        found["slew"] = Lump(1.0, np.zeros(3), np.diag([0.5 * turning, 0.5 * turning, turning]))
    if errors.rocking_base.enabled:
        base = errors.rocking_base
        squares = base.mass_kg * np.asarray(base.gyration_m) ** 2
        found["base_yaw"] = Lump(base.mass_kg, np.asarray(base.centre_m), np.diag(squares))
    found[[n for n in ("slew", "slew_play", "ring_pitch") if n in names][-1]] = pillar
    return found


def build_bodies(config: PlantConfig, chain: Chain) -> list[Lump]:
    """The bodies (n) without payload, where the chain's deviations put them; massless ones between axes."""
    masses, origin, names = config.masses, chain.link_origin, chain.names
    boom, arm = hinges_of(config)
    telescope = tuple(_moved_out(part, config.geometry.telescope_m) for part in masses.telescope)
    lift, tilt, wrist = (origin[names.index(name)] for name in ("lift", "tilt", "wrist1"))
    nominal = _foot(config, names)
    nominal |= _segments("boom", "lift", names, _lumps_between(masses.boom, lift, boom))
    nominal |= _segments("arm", "tilt", names, _lumps_between(masses.arm + telescope, tilt, arm))
    wrists = (("wrist1", masses.wrist1), ("wrist2", masses.wrist2), ("wrist3", masses.tool))
    nominal |= {name: _wrist(body, wrist) for name, body in wrists}
    bodies: list[Lump] = []
    for i, name in enumerate(names):
        rotation, shift = chain.deviation[i, :3, :3], chain.deviation[i, :3, 3]
        lump = nominal.get(name, NOTHING)
        bodies.append(Lump(lump.mass, rotation @ lump.centre + shift, rotation @ lump.inertia @ rotation.T))
    return bodies
