"""A directory to begin an arm with: what differs from machine to machine, copied from one that is there."""

import os
from pathlib import Path
from typing import Any

import yaml

from foundation.configuration import BASE_FILE
from protocol.errors import ConfigurationError
from testbed.scenarios.settings import Settings

_OF_ONE_ARM = {
    "arm": ("name", "dh", "joints", "drives", "rated", "workspace"),
    "plant": ("start_pose_deg", "geometry", "masses", "flexibility", "actuators"),
    "scene": ("object_of_interest.position_m",),
}
_SAID = "# Copied from {like}, to be edited. What is left out here is as in the directory of base.yaml.\n"


def begin_arm(directory: Path, like: Path, settings: Settings) -> list[Path]:
    """Write an arm over ``like``, whose configuration is ``settings``, into ``directory``; the files.

    Raises ConfigurationError when the directory is there and not empty.
    """
    if directory.is_dir() and any(directory.iterdir()):
        raise ConfigurationError("configuration.not_empty", f"{directory} is there and holds files")
    directory.mkdir(parents=True, exist_ok=True)
    below = os.path.relpath(like.resolve(), directory.resolve())
    written = [_write(directory / BASE_FILE, like, {"over": below})]
    for stem, keys in _OF_ONE_ARM.items():
        whole = getattr(settings, stem).model_dump(mode="json", exclude_none=True)
        chosen: dict[str, Any] = {}
        for key in keys:
            first, _, second = key.partition(".")
            chosen[first] = {second: whole[first][second]} if second else whole[first]
        written.append(_write(directory / f"{stem}.yaml", like, chosen))
    return written


def _write(path: Path, like: Path, content: dict[str, Any]) -> Path:
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110)
    path.write_text(_SAID.format(like=like) + text, encoding="utf-8")
    return path
