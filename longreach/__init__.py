"""Longreach from Python: a rig in simulated time or over REST, the nominal arm's kinematics, the plant alone.

``read`` gives recordings as arrays, ``replay`` runs vision's again, ``plot`` draws a look or a run.
A thin face: every result is the type that the parts themselves return, in SI units and radians.
Expected trouble is a ``LongreachError`` with its ``cause``. ``longreach.aio`` has the same for ``async``.
"""

from importlib.metadata import version

from longreach import aio
from longreach.models import arm, plant
from longreach.plotting import plot
from longreach.recordings import read
from longreach.replaying import Replay, replay
from longreach.rigs import connect, lockstep
from protocol.errors import LongreachError

__version__ = version("longreach")
__all__ = ["LongreachError", "Replay", "aio", "arm", "connect", "lockstep", "plant", "plot", "read", "replay"]
