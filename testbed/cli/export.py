"""`longreach export`: the arm as a file that other tools read."""

from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.options import DEFAULT_CONFIG, ConfigDir, JsonFile, Settings
from testbed.cli.root import CommandApp
from testbed.reporting.console import out, writable, write_json

app = CommandApp(help="The arm as a file for other tools.", no_args_is_help=True)


@app.command(epilog="Example: longreach export urdf --out arm.urdf")
def urdf(
    file: Annotated[Path, typer.Option("--out", help="Where the file goes.", callback=writable)],
    masses: Annotated[
        bool, typer.Option("--masses", help="With the masses of its parts by drawing.")
    ] = False,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    json_file: JsonFile = None,
) -> None:
    """The nominal arm as URDF, for ROS, MuJoCo, Pinocchio, Drake and viewers.

    With frames of camera, markers and object, collision shapes and a ros2_control block.
    """
    from foundation.configuration import parse_overrides
    from testbed.exports import arm_tree
    from testbed.exports.planning import for_planning, with_masses
    from testbed.scenarios.scenario import load_settings

    chosen = load_settings(config_dir, parse_overrides(settings or []))
    tree = for_planning(arm_tree.nominal_tree(chosen.arm), chosen)
    if masses:
        tree = with_masses(tree, chosen.arm, chosen.plant)
    file.write_text(arm_tree.urdf(tree), encoding="utf-8")
    names = [joint.name for joint in tree.joints]
    mass_kg = sum(joint.body.mass for joint in tree.joints)
    weight = f"{mass_kg:.1f} kg" if masses else "no masses"
    out.print(f"{file}: {tree.name}, {len(names)} joints, {weight}", highlight=False, soft_wrap=True)
    write_json(json_file, {"file": file, "name": tree.name, "joints": names, "mass_kg": mass_kg})
