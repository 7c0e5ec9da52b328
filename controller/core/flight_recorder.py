"""The flight record: the last scans before a fault, and some after it."""

from typing import Any

from controller.core.scan_types import ScanInput, ScanOutput

Scan = tuple[ScanInput, ScanOutput]


def plain(scan: Scan) -> dict[str, Any]:
    """One scan as plain data; times in ns and s, angles in rad, pressures in bar."""
    inputs, output = scan
    view = output.view._asdict()
    view |= {name: int(view[name]) for name in ("group_state", "fault", "severity")}
    view |= {name: view[name]._asdict() for name in ("X_BT", "X_BT_cmd")}
    return {
        "dt_s": inputs.dt_s,
        "reference_link_alive": inputs.reference_link_alive,
        "sensors": None if inputs.sensors is None else inputs.sensors._asdict(),
        "requests": [{"kind": type(request).__name__, **request._asdict()} for request in inputs.requests],
        "streamed": None if inputs.streamed is None else inputs.streamed.message._asdict(),
        "refusal": None if output.refusal is None else output.refusal._asdict(),
        "acknowledgements": [answer._asdict() for answer in output.acknowledgements],
        "events": [event._asdict() for event in output.events],
        "valve_image": output.valves._asdict(),
        "view": view,
    }
