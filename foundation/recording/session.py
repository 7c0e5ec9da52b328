"""What belongs together: one session of several processes, and what each of them was made of."""

import importlib.metadata
import os
import platform
import uuid
from collections.abc import Mapping

SESSION_VARIABLE = "LONGREACH_SESSION"
_PACKAGES = ("longreach", "numpy", "scipy", "numba", "opencv-python-headless")


def session_entries(service: str, environment: Mapping[str, str] | None = None) -> dict[str, str]:
    """The metadata ``session`` of a recording: its ``id``, from LONGREACH_SESSION or made anew, the
    ``service``, versions, and the kind of machine.
    """
    known = os.environ if environment is None else environment
    made = {"id": known.get(SESSION_VARIABLE) or str(uuid.uuid4()), "service": service}
    versions = {f"version {name}": _version(name) for name in _PACKAGES}
    return made | versions | {"version python": platform.python_version(), "machine": platform.machine()}


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "absent"
