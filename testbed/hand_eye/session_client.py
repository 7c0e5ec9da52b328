"""The guided session of a running vision PC, over its REST face."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from foundation.secret_source import secret_from_file
from testbed.realtime.rest_rig import RestRig
from testbed.reporting.console import bars

JSON = dict[str, Any]


class SessionClient(RestRig):
    """Commands of the session; each raises what the problem document says."""

    def step(self, kind: str, body: JSON, what: str) -> JSON:
        """The result of operation ``hand-eye-<kind>``, with its progress shown."""
        with bars() as shown, shown.step(what) as bar:
            return self.result(f"hand-eye-{kind}", body, bar)

    def view(self) -> JSON:
        """The open session."""
        return self._ask("GET", "/hand-eye/session")

    def names(self) -> list[str]:
        """The sessions on the vision PC's disk."""
        names: list[str] = self._ask("GET", "/hand-eye/sessions")["names"]
        return names

    def resume(self, name: str) -> JSON:
        """A session from the disk, opened."""
        return self._ask("POST", "/hand-eye/session/resume", json={"name": name})

    def propose(self, informative: bool = True) -> JSON:
        """The next pose."""
        return self._ask("POST", "/hand-eye/session/propose", json={"informative": informative})

    def remove(self, name: str) -> JSON:
        """The session without a sample."""
        return self._ask("DELETE", f"/hand-eye/session/samples/{name}")


def with_session(url: str, token_file: Path | None, act: Callable[[SessionClient], None]) -> None:
    """Call ``act`` with a connection to the vision PC at ``url``, and close it.

    ``token_file``: where the token of the role ``operate`` is, if one is wanted. Raises ConfigurationError as
    ``secret_from_file`` does.
    """
    face = SessionClient(url, None if token_file is None else secret_from_file(token_file, "operate token"))
    try:
        act(face)
    finally:
        face.close()
