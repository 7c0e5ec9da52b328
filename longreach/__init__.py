"""Longreach from Python: a rig in simulated time or over REST, the nominal arm's kinematics, the plant alone.

``read`` gives recordings as arrays, ``replay`` runs vision's again, ``plot`` draws a look or a run.
A thin face: every result is the type that the parts themselves return, in SI units and radians.
Expected trouble is a ``LongreachError`` with its ``cause``.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from protocol.errors import LongreachError

if TYPE_CHECKING:
    from longreach.models import arm, plant
    from longreach.plotting import plot
    from longreach.recordings import read
    from longreach.replaying import Replay, replay
    from longreach.rigs import connect, lockstep

__version__ = version("longreach")
__all__ = ["LongreachError", "Replay", "arm", "connect", "lockstep", "plant", "plot", "read", "replay"]
_MODULES = {
    "Replay": "replaying", "arm": "models", "connect": "rigs", "lockstep": "rigs", "plant": "models",
    "plot": "plotting", "read": "recordings", "replay": "replaying",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is first asked for: all of it takes seconds."""
    if name not in _MODULES:
        raise AttributeError(f"module 'longreach' has no attribute {name!r}")
    return getattr(import_module(f"longreach.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    """The names that are imported when they are asked for, too."""
    return sorted({*globals(), *__all__})
