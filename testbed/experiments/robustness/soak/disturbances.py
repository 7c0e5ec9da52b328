"""Faults at random times of a soak: drawn by seed, injected over the plant's fault API."""

import threading
from typing import Any, NamedTuple

import httpx
import numpy as np

from testbed.experiments.robustness.soak.incidents import Journal
from testbed.realtime.rest_rig import bearer

_GAP_S = (30.0, 90.0)
_TIMEOUT_S = 5.0


class Disturbance(NamedTuple):
    """A kind of fault with its parameters, and for how long (s, from … to) it may last."""

    fault: dict[str, Any]
    duration_s: tuple[float, float]

    @property
    def name(self) -> str:
        """Its kind, with its joint where it has one."""
        joint = self.fault.get("joint")
        return f"{self.fault['kind']}.{joint}" if joint else str(self.fault["kind"])


# What a machine meets within an hour of a bad day; each leaves a plant that can go on.
DISTURBANCES = (
    Disturbance({"kind": "camera_blind"}, (0.5, 4.0)),
    Disturbance({"kind": "camera_frozen"}, (0.5, 4.0)),
    Disturbance({"kind": "frames_dropped", "share": 0.5}, (2.0, 8.0)),
    Disturbance({"kind": "marker_covered", "marker_id": 0, "share": 0.5}, (2.0, 8.0)),
    Disturbance({"kind": "valve_slow", "joint": "lift", "bandwidth_share": 0.3}, (5.0, 15.0)),
    Disturbance({"kind": "valve_stuck", "joint": "tilt"}, (0.5, 3.0)),
    Disturbance({"kind": "supply_lost"}, (0.5, 2.0)),
    Disturbance({"kind": "encoder_stuck", "joint": "slew"}, (0.5, 2.0)),
    Disturbance({"kind": "encoder_jump", "joint": "wrist2", "angle_mrad": 300.0}, (0.5, 2.0)),
    Disturbance({"kind": "payload_change", "mass_kg": 60.0}, (5.0, 15.0)),
    Disturbance({"kind": "coupler_silent"}, (0.02, 1.0)),
)


class RandomFaults(threading.Thread):
    """Injects ``DISTURBANCES`` one after another, in an order and at times drawn by ``seed``, until ended."""

    def __init__(self, url: str, token: bytes | None, journal: Journal, seed: int) -> None:
        super().__init__(daemon=True)
        self._rng = np.random.default_rng(seed)
        self._journal = journal
        self._ended = threading.Event()
        self._client = httpx.Client(base_url=url, timeout=_TIMEOUT_S, headers=bearer(token))

    def end(self) -> None:
        """Inject nothing more; mend what is broken."""
        self._ended.set()
        self.join()
        self._client.delete("/faults")
        self._client.close()

    def run(self) -> None:
        """The thread's work."""
        while not self._ended.wait(self._rng.uniform(*_GAP_S)):
            chosen = DISTURBANCES[self._rng.integers(len(DISTURBANCES))]
            duration_s = float(self._rng.uniform(*chosen.duration_s))
            try:
                answer = self._client.post("/faults", json={"fault": chosen.fault, "duration_s": duration_s})
            except httpx.HTTPError as error:
                self._journal.incident("fault API", "link.rest", f"{chosen.name}: {error!r}")
                continue
            if answer.is_success:
                self._journal.fault(chosen.name, duration_s)
            else:
                self._journal.incident("fault API", str(answer.json().get("cause")), answer.text)
