"""`longreach export`: the arm as a file that other tools read."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from protocol.errors import ConfigurationError
from testbed.cli.options import DEFAULT_CONFIG, ConfigDir, JsonFile, Settings
from testbed.cli.root import CommandApp
from testbed.reporting.console import out, writable, write_json

if TYPE_CHECKING:
    from testbed.exports.arm_tree import ArmTree
    from testbed.scenarios.scenario import Settings as EverySetting

app = CommandApp(help="The arm as a file for other tools.", no_args_is_help=True)

Target = Annotated[Path, typer.Option("--out", help="Where the file goes.", callback=writable)]
TrueArm = Annotated[
    bool,
    typer.Option("--true", help="The plant's own arm, with hinges and masses, instead of the nominal one."),
]


Masses = Annotated[
    bool, typer.Option("--masses", help="The nominal arm with the masses of its parts by drawing.")
]


@app.command("urdf", epilog="Example: longreach export urdf --out arm.urdf")
def urdf_command(
    file: Target,
    true: TrueArm = False,
    masses: Masses = False,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    json_file: JsonFile = None,
) -> None:
    """The arm as URDF, for ROS, Pinocchio and viewers: links, joints, masses; no springs, no gravity.

    The nominal arm has frames of camera, markers and object, collision shapes and a ros2_control block too.
    """
    from testbed.exports.arm_tree import urdf
    from testbed.exports.planning import for_planning, with_masses

    tree = _tree(config_dir, settings, true)
    if not true:
        chosen = _chosen(config_dir, settings)
        tree = for_planning(tree, chosen)
        if masses:
            tree = with_masses(tree, chosen.arm, chosen.plant)
    _write(urdf, tree, file, json_file)


@app.command("srdf", epilog="Example: longreach export srdf --out arm.srdf")
def srdf_command(
    file: Target,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    json_file: JsonFile = None,
) -> None:
    """What MoveIt wants beside the nominal arm's URDF: group, tip, home, and pairs that never collide."""
    from testbed.exports.arm_tree import nominal_tree
    from testbed.exports.planning import srdf

    chosen = _chosen(config_dir, settings)
    home = tuple(map(math.radians, chosen.plant.start_pose_deg))
    _write(lambda tree: srdf(tree, home), nominal_tree(chosen.arm), file, json_file)


@app.command("mjcf", epilog="Example: longreach export mjcf --true --out arm.xml")
def mjcf_command(
    file: Target,
    true: TrueArm = False,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    json_file: JsonFile = None,
) -> None:
    """The arm as MJCF, for MuJoCo; with --true also the springs and dampers of its hinges, and gravity."""
    from testbed.exports.arm_tree import mjcf

    _write(mjcf, _tree(config_dir, settings, true, springs=True), file, json_file)


def _tree(config_dir: Path, assignments: list[str] | None, true: bool, springs: bool = False) -> "ArmTree":
    """The arm that was asked for.

    Raises ConfigurationError (``export.inexpressible``) for ``springs`` of a true arm that has forces which
    are no springs of one joint.
    """
    from testbed.exports.arm_tree import inexpressible, nominal_tree, true_tree

    chosen = _chosen(config_dir, assignments)
    if not true:
        return nominal_tree(chosen.arm)
    left_out = inexpressible(chosen.plant) if springs else []
    if left_out:
        off = " ".join(f"--set {key}=false" for key in left_out)
        raise ConfigurationError(
            "export.inexpressible",
            f"{', '.join(left_out)}: MJCF has no form for these forces; export without them: {off}",
        )
    return true_tree(chosen.arm, chosen.plant)


def _chosen(config_dir: Path, assignments: list[str] | None) -> "EverySetting":
    from foundation.configuration import parse_overrides
    from testbed.scenarios.scenario import load_settings

    return load_settings(config_dir, parse_overrides(assignments or []))


def _write(form: "Callable[[ArmTree], str]", tree: "ArmTree", file: Path, json_file: Path | None) -> None:
    text = form(tree)
    file.write_text(text, encoding="utf-8")
    moving = [joint.name for joint in tree.joints if not joint.locked]
    mass_kg = sum(joint.body.mass for joint in tree.joints)
    weight = f"{mass_kg:.1f} kg" if mass_kg > 0.0 else "no masses"
    out.print(f"{file}: {tree.name}, {len(moving)} joints, {weight}", highlight=False, soft_wrap=True)
    write_json(json_file, {"file": file, "name": tree.name, "joints": moving, "mass_kg": mass_kg})
