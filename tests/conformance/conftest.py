"""The suite's simulated time, for every test that asks a controller in it."""

from collections.abc import Iterator

import pytest

from tests.conformance.couplers import ShiftedClock, ThreadedCoupler
from tests.conformance.simulated_network import SimulatedNetwork, simulated


@pytest.fixture
def network() -> Iterator[SimulatedNetwork]:
    """Suite and controllers share one simulated clock; no sockets, no waiting."""
    with simulated() as network:
        yield network


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> ShiftedClock:
    """The coupler's suite and the coupler share a clock that is moved instead of waited for."""
    clock = ShiftedClock()
    monkeypatch.setattr(ThreadedCoupler, "clock", clock)
    monkeypatch.setattr("conformance.coupler.steps.time", clock)
    return clock
