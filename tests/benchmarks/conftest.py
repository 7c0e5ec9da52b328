"""Fixtures of the folders whose parts are measured here."""

from tests.browser.conftest import browser
from tests.vision_pc.conftest import camera, config, generator

__all__ = ["browser", "camera", "config", "generator"]
