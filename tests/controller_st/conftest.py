"""The suite's simulated time, as for the other controllers."""

from tests.conformance.conftest import network

__all__ = ["network"]
