"""Longreach from Python: a rig in simulated time or over REST, the nominal arm's kinematics, the plant alone.

``read`` gives recordings as arrays.
A thin face: every result is the type that the parts themselves return, in SI units and radians.
Expected trouble is a ``LongreachError`` with its ``cause``. ``longreach.aio`` has the same for ``async``.
"""

from longreach import aio
from longreach.models import arm, plant
from longreach.recordings import read
from longreach.rigs import connect, lockstep
from protocol.errors import LongreachError

__all__ = ["LongreachError", "aio", "arm", "connect", "lockstep", "plant", "read"]
