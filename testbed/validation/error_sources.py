"""Every source of error of the plant by itself: its switch, where its number comes from, what it alone does.

The base is an arm and a camera without any of them; each is then switched on alone, with the shipped numbers,
where need be beside what it acts through: a load, a beam that bends, a base that rocks.
What else disturbs a picture is shown by `longreach picture effects`.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from foundation.configuration import load, merged
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.plant import NOMINAL_MOUNTS
from protocol.errors import ConfigurationError
from testbed.validation import error_measures as measure

Array = NDArray[np.float64]
Keys = dict[str, Any]

_OFF: Keys = {"enabled": False}
_MARK = re.compile(r"#.*?(\[[SMERD]\])")


class Source(NamedTuple):
    """One source. ``key``: file and dotted key, where its number and provenance stand.

    By file, ``off``: what takes it away, ``on``: what brings it where it is shipped off, ``given``: what is
    there with and without it.

    ``measured`` makes of a world a number or vector in ``unit``; what the source alone does is the length of
    the difference that it makes, or the change in percent where the unit is ``%``.
    """

    name: str
    key: str
    off: Keys
    measured: Callable[[measure.MeasuredWorld], Array | float]
    effect: str
    unit: str
    on: Mapping[str, Any] = MappingProxyType({})
    given: Mapping[str, Any] = MappingProxyType({})


class Finding(NamedTuple):
    """What one source alone does."""

    name: str
    key: str
    provenance: str
    effect: str
    unit: str
    value: float


def sources(nominal_lens: Keys) -> tuple[Source, ...]:
    """Every source of error; ``nominal_lens`` is what the vision side takes the lens for."""
    return (*_of_the_arm(), *_of_the_structure(), *_of_what_is_seen(nominal_lens))


def _of_the_arm() -> tuple[Source, ...]:
    return (
        Source("boom flexibility", "plant.flexibility", {"plant": {"flexibility": _OFF}}, measure.tool_mm,
               "tool sags at the start pose", "mm"),
        Source("geometry", "plant.errors.geometry", _off("geometry"), measure.tool_mm,
               "tool off the rigid model", "mm"),
        Source("base tilt", "plant.errors.base_tilt", _off("base_tilt"), measure.tool_mm,
               "tool moves in the world", "mm"),
        Source("encoder offsets", "plant.errors.encoder_offsets", _off("encoder_offsets"),
               measure.reading_mrad, "readings off, all six", "mrad"),
        Source("encoder noise", "plant.errors.encoder_noise", _off("encoder_noise"), measure.noise_lsb,
               "spread of readings at rest", "LSB"),
        Source("backlash", "plant.errors.backlash", _off("backlash"), measure.trailing_mrad,
               "reading trails a turning slew", "mrad"),
        Source("valve deadband", "plant.valve_sets.servo.deadband", _off("valve_deadband"),
               lambda world: measure.slew_mrad_s(world, 0.02), "slew speed at 2 % spool", "%"),
        Source("friction", "plant.actuators.slew.rotary.friction", _off("friction"),
               lambda world: measure.slew_mrad_s(world, 0.1), "slew speed at 10 % spool", "%"),
        Source("leakage", "plant.actuators.slew.leakage_m3_s_pa", _off("leakage"), measure.sunk_mm,
               "tool sinks in 20 s, valves shut", "mm"),
        Source("thermal drift", "plant.oil.temperature_degc", {"plant": {"oil": {"thermal_drift": False}}},
               measure.oil_k, "oil warms in 4 s of full work", "K"),
    )  # fmt: skip


def _of_the_structure() -> tuple[Source, ...]:
    """What plant.yaml ships switched off."""
    aside: Keys = {"payload": {"mass_kg": 50.0, "centre_m": [0.3, 0.0, 0.0]}}
    bent: Keys = {"flexibility": {"enabled": True}}
    rocking: Keys = {"errors": {"rocking_base": {"enabled": True}}}
    rows: tuple[tuple[str, str, Callable[[measure.MeasuredWorld], Array], str, str, Keys], ...] = (
        ("encoder eccentricity", "encoder_eccentricity", measure.reading_mrad,
         "readings off, all six", "mrad", {}),
        ("several hinges", "finer_bending", measure.tool_mm, "tool, of sag at the start pose", "mm", bent),
        ("torsion", "torsion", measure.tool_turned_mrad, "50 kg 0.3 m aside turn the tool", "mrad", aside),
        ("pins", "pin_compliance", measure.tool_turned_mrad,
         "50 kg 0.3 m aside turn the tool", "mrad", aside),
        ("slewing ring", "bearing_tilt", measure.tool_mm, "tool sags at the start pose", "mm", {}),
        ("loose slew", "loose_slew", measure.tool_mm, "tool lies aside at the start pose", "mm", {}),
        ("rocking base", "rocking_base", measure.tool_mm, "tool sags at the start pose", "mm", {}),
        ("engine and pump", "vibration", measure.shaken_mm, "rms of the tool at rest", "mm", rocking),
    )  # fmt: skip
    return tuple(
        Source(name, f"plant.errors.{entry}", _off(entry), measured, effect, unit, _on(entry),
               {"plant": given})
        for name, entry, measured, effect, unit, given in rows
    )  # fmt: skip


def _off(entry: str) -> Keys:
    return {"plant": {"errors": {entry: _OFF}}}


def _on(entry: str) -> Keys:
    return {"plant": {"errors": {entry: {"enabled": True}}}}


def _of_what_is_seen(nominal_lens: Keys) -> tuple[Source, ...]:
    marker: Keys = {
        "offset_m": [0.0, 0.0, 0.0],
        "misalignment_deg": [0.0, 0.0, 0.0],
        "print_scale_error": 0.0,
    }
    level = {"vertical_px": 0.0, "disparity_px": 0.0, "right_eye_rotation_deg": [0.0, 0.0, 0.0]}
    straight = {"k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "k3": 0.0}
    return (
        Source("camera mount, position", "scene.mount.position_m",
               {"scene": {"mount": {"position_m": NOMINAL_MOUNTS.X_TC[:3, 3].tolist()}}}, measure.mount_mm,
               "camera off its nominal place", "mm"),
        Source("camera mount, rotation", "scene.mount.rotation_deg",
               {"scene": {"mount": {"rotation_deg": [0.0, 0.0, 0.0]}}}, measure.mount_deg,
               "camera turned", "deg"),
        Source("tool marker, offset", "scene.tool_marker.offset_m", {"scene": {"tool_marker": marker}},
               measure.marker_mm, "tool marker off the tool", "mm"),
        Source("tool marker, misalignment", "scene.tool_marker.misalignment_deg",
               {"scene": {"tool_marker": marker}}, measure.marker_deg, "tool marker turned", "deg"),
        Source("print size", "scene.tool_marker.print_scale_error", {"scene": {"tool_marker": marker}},
               measure.printed_mm, "printed side off", "mm"),
        Source("lens", "scene.camera.lens.fx_px", {"scene": {"camera": {"lens": nominal_lens | straight}}},
               lambda world: measure.image_px(world, 0), "image off, rms over the left picture", "px"),
        Source("rectification", "scene.camera.rectification.vertical_px",
               {"scene": {"camera": {"rectification": level}}},
               lambda world: measure.image_px(world, 1), "image off, rms over the right picture", "px"),
        Source("picture noise", "scene.camera.noise_grey", {"scene": {"camera": {"noise_grey": 0.0}}},
               measure.noise_grey, "spread of a pixel", "grey"),
    )  # fmt: skip


def findings(config_dir: Path, nominal_lens: Keys) -> Iterator[Finding]:
    """What each source alone does, one after the other.

    Raises ConfigurationError when a source's key has no provenance.
    """
    known = sources(nominal_lens)
    off: Keys = {}
    for source in known:
        off = merged(off, source.off)
    for source in known:
        others: Keys = {}
        for other in known:
            if other.off != source.off:
                others = merged(others, other.off)
        there = merged(merged(others, source.on), source.given)
        worlds = (_world(config_dir, there), _world(config_dir, merged(off, source.given)))
        alone, without = (np.asarray(source.measured(world)) for world in worlds)
        change = float(np.linalg.norm(alone - without))
        value = 100.0 * float((alone - without) / without) if source.unit == "%" else change
        mark = provenance(config_dir, source.key)
        yield Finding(source.name, source.key, mark, source.effect, source.unit, value)


def provenance(config_dir: Path, key: str) -> str:
    """The mark beside ``key`` (file, then dotted key), or beside the first number below it.

    Raises ConfigurationError when the key does not exist or has none.
    """
    stem, *path = key.split(".")
    file = config_dir / f"{stem}.yaml"
    lines = file.read_text(encoding="utf-8").splitlines()
    node = yaml.compose("\n".join(lines), Loader=yaml.SafeLoader)
    first = last = 0
    for part in path:
        pairs = node.value if isinstance(node, yaml.MappingNode) else []
        found = next(((name, value) for name, value in pairs if name.value == part), None)
        if found is None:
            raise ConfigurationError("configuration.no_such_key", f"{file}: {key}: there is no '{part}'")
        first, node = found[0].start_mark.line, found[1]
        last = max(node.end_mark.line, first + 1)
    for line in lines[first:last]:
        if mark := _MARK.search(line):
            return mark.group(1)
    raise ConfigurationError("configuration.no_provenance", f"{file}: {key}: no [S], [M], [E], [R] or [D]")


def _world(config_dir: Path, overrides: Keys) -> measure.MeasuredWorld:
    plant = load(PlantConfig, config_dir / "plant.yaml", overrides.get("plant"))
    return measure.MeasuredWorld(plant, load(SceneConfig, config_dir / "scene.yaml", overrides.get("scene")))
