"""Writes grafana/longreach.json, the dashboard of the compose profile ``metrics``, from the table below."""

import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

PATH = Path("grafana/longreach.json")
_SOURCE = {"type": "prometheus", "uid": "longreach"}
_WINDOW = "1m"
_COLUMNS, _WIDTH, _HEIGHT = 3, 8, 7


class DashboardPanel(NamedTuple):
    """A panel over time. ``curves``: expression by legend; ``unit`` as Grafana names it."""

    title: str
    unit: str
    curves: Mapping[str, str]


def _rate(metric: str) -> str:
    return f"rate({metric}[{_WINDOW}])"


def _quantile(share: float, metric: str) -> str:
    return f"histogram_quantile({share}, rate({metric}_bucket[{_WINDOW}]))"


def _spread(metric: str) -> dict[str, str]:
    return {"median": _quantile(0.5, metric), "99 %": _quantile(0.99, metric)}


_C, _P, _V = "longreach_controller", "longreach_plant_emulator", "longreach_vision_pc"

_SUPPLY = {
    "measured": f"{_V}_controller_supply_pressure_pascals",
    "true": f"{_P}_true_supply_pressure_pascals",
}
_DROPPED = (
    ("recording", "recording_dropped"),
    ("viewers", "live_dropped"),
    ("log", "log_lines_dropped"),
)

PANELS = (
    DashboardPanel("Scan lateness", "s", _spread(f"{_C}_scan_lateness_seconds")),
    DashboardPanel("Scan duration", "s", _spread(f"{_C}_scan_duration_seconds")),
    DashboardPanel(
        "Scans and steps left out",
        "cps",
        {"scans": _rate(f"{_C}_scan_overruns_total"), "steps": _rate(f"{_P}_steps_missed_total")},
    ),
    DashboardPanel("Exchange with the plant", "s", _spread(f"{_C}_plant_round_trip_seconds")),
    DashboardPanel(
        "Exchanges that failed", "cps", {"{{cause}}": _rate(f"{_C}_plant_exchange_failures_total")}
    ),
    DashboardPanel("Step lateness of the plant", "s", _spread(f"{_P}_step_lateness_seconds")),
    DashboardPanel(
        "Reference link: age and round trip",
        "s",
        {"age of the state": f"{_V}_link_state_age_seconds", "round trip": f"{_V}_link_round_trip_seconds"},
    ),
    DashboardPanel(
        "Reference link: datagrams lost",
        "cps",
        {
            "to the vision PC": _rate(f"{_V}_link_datagrams_lost_total"),
            "to the controller": _rate(f"{_C}_reference_link_datagrams_lost_total"),
        },
    ),
    DashboardPanel(
        "Links and camera",
        "bool",
        {
            "link": f"{_V}_link_connected",
            "plant": f"{_V}_controller_plant_link_ok",
            "camera": f"{_V}_camera_connected",
        },
    ),
    DashboardPanel(
        "Pictures",
        "cps",
        {
            "used by vision": _rate(f"{_V}_camera_frames_total"),
            "rendered": _rate(f"{_P}_camera_frames_rendered_total"),
            "left out": _rate(f"{_P}_camera_frames_skipped_total"),
        },
    ),
    DashboardPanel("Age of the newest pair", "s", {"age": f"{_V}_camera_frame_age_seconds"}),
    DashboardPanel("Looks", "short", {"looks": f"{_V}_looks_total"}),
    DashboardPanel("Error as the newest look told it", "lengthm", {"{{axis}}": f"{_V}_look_error_meters"}),
    DashboardPanel("Its standard deviation as told", "lengthm", {"{{axis}}": f"{_V}_look_error_std_meters"}),
    DashboardPanel("Supply pressure", "pressurepa", _SUPPLY),
    DashboardPanel("Oil temperature (truth)", "celsius", {"oil": f"{_P}_true_oil_temperature_celsius"}),
    DashboardPanel(
        "Memory",
        "bytes",
        {
            "controller": f"{_C}_resident_memory_bytes",
            "plant": f"{_P}_resident_memory_bytes",
            "renderer": f"{_P}_renderer_resident_memory_bytes",
            "vision": f"{_V}_resident_memory_bytes",
        },
    ),
    DashboardPanel(
        "What queues dropped",
        "cps",
        {
            f"{kind}, {who}": _rate(f"{service}_{metric}_total")
            for who, service in (("controller", _C), ("plant", _P), ("vision", _V))
            for kind, metric in _DROPPED
        },
    ),
    DashboardPanel("Requests refused", "cps", {"{{cause}}": _rate(f"{_V}_rest_refused_total")}),
)  # fmt: skip


def dashboard() -> dict[str, Any]:
    """The dashboard as Grafana loads it."""
    return {
        "uid": "longreach",
        "title": "Longreach",
        "timezone": "browser",
        "schemaVersion": 39,
        "refresh": "5s",
        "time": {"from": "now-15m", "to": "now"},
        "panels": [_panel(number, panel) for number, panel in enumerate(PANELS)],
    }


def expressions_of(document: Mapping[str, Any]) -> list[str]:
    """Every expression of a dashboard."""
    return [target["expr"] for panel in document["panels"] for target in panel["targets"]]


def metrics_of(document: Mapping[str, Any]) -> set[str]:
    """Every metric that a dashboard asks for."""
    return {name for each in expressions_of(document) for name in re.findall(r"longreach_[a-z0-9_]+", each)}


def _panel(number: int, panel: DashboardPanel) -> dict[str, Any]:
    row, column = divmod(number, _COLUMNS)
    targets = [
        {"refId": chr(ord("A") + place), "expr": expression, "legendFormat": legend, "datasource": _SOURCE}
        for place, (legend, expression) in enumerate(panel.curves.items())
    ]
    return {
        "id": number + 1,
        "type": "timeseries",
        "title": panel.title,
        "datasource": _SOURCE,
        "gridPos": {"x": column * _WIDTH, "y": row * _HEIGHT, "w": _WIDTH, "h": _HEIGHT},
        "fieldConfig": {"defaults": {"unit": panel.unit}, "overrides": []},
        "targets": targets,
    }


def text() -> str:
    """What the file holds."""
    return json.dumps(dashboard(), indent=1) + "\n"


def main() -> int:
    """Write it."""
    PATH.parent.mkdir(exist_ok=True)
    PATH.write_text(text(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
