"""Arms by name: directories of configuration in ``arms/``, each laid over the files that all arms share."""

from difflib import get_close_matches
from pathlib import Path
from typing import Any

from foundation.configuration import BASE_FILE, layers, merged, read_yaml
from protocol.errors import ConfigurationError

ARMS_DIR = "arms"
DEFAULT_ARM = "default"
_FORMER = {"plant": DEFAULT_ARM, "plant_long_crane": "long_crane"}  # in rows of campaigns that are kept


def arm_names(config_dir: Path) -> list[str]:
    """The arms that ``config_dir`` holds, sorted."""
    return sorted(path.parent.name for path in (config_dir / ARMS_DIR).glob(f"*/{BASE_FILE}"))


def arm_directory(config_dir: Path, arm: str) -> Path:
    """The configuration directory of the arm called ``arm``; what has a slash is a directory of its own.

    Raises ConfigurationError where there is none.
    """
    if "/" in arm:
        if not Path(arm).is_dir():
            raise ConfigurationError("configuration.unknown_arm", f"no directory {arm}")
        return Path(arm)
    name = _FORMER.get(arm, arm)
    known = arm_names(config_dir)
    if name not in known:
        close = get_close_matches(name, known, 1)
        hint = f"did you mean {close[0]}?" if close else f"known: {', '.join(known) or 'none'}"
        why = f"no arm '{arm}' in {config_dir / ARMS_DIR}; {hint}"
        raise ConfigurationError("configuration.unknown_arm", why)
    return config_dir / ARMS_DIR / name


def arm_overrides(config_dir: Path, arm: str) -> dict[str, Any]:
    """What ``arm`` lays over the files of ``config_dir``, by file stem; the default arm is as they have it.

    Raises ConfigurationError.
    """
    if _FORMER.get(arm, arm) == DEFAULT_ARM:
        return {}
    shared = {path.resolve() for path in layers(config_dir)}
    overrides: dict[str, Any] = {}
    for directory in layers(arm_directory(config_dir, arm)):
        if directory.resolve() not in shared:
            files = (file for file in sorted(directory.glob("*.yaml")) if file.name != BASE_FILE)
            overrides = merged(overrides, {file.stem: read_yaml(file) for file in files})
    return overrides
