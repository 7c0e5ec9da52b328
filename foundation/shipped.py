"""Where the configuration that comes with Longreach is: in a checkout, or in what a wheel installed."""

from pathlib import Path

from protocol.errors import ConfigurationError

_BESIDE = Path(__file__).parents[1]


def shipped_configs() -> Path:
    """The directory of the shipped configuration. Raises ConfigurationError when it is not there."""
    for directory in (_BESIDE / "longreach" / "configs", _BESIDE / "configs"):
        if (directory / "arm.yaml").is_file():
            return directory
    raise ConfigurationError("configuration.not_shipped", f"no configuration beside {_BESIDE / 'longreach'}")


def usual_configs() -> Path:
    """``configs`` of the working directory where there is one, else the shipped configuration."""
    here = Path("configs")
    return here if here.is_dir() else shipped_configs()
