"""The shipped Grafana dashboard, and what it asks Prometheus for."""

import json
import re
from typing import Any

from tests.support.paths import ROOT


def dashboard() -> dict[str, Any]:
    """The dashboard as Grafana loads it."""
    document: dict[str, Any] = json.loads((ROOT / "grafana" / "longreach.json").read_text(encoding="utf-8"))
    return document


def expressions() -> list[str]:
    """Every expression of it."""
    return [target["expr"] for panel in dashboard()["panels"] for target in panel["targets"]]


def metrics() -> set[str]:
    """Every metric that it asks for."""
    return {name for each in expressions() for name in re.findall(r"longreach_[a-z0-9_]+", each)}
