"""What the vision PC counts of itself, of its link and of the controller, and what Prometheus calls that."""

from dataclasses import fields

from fastapi import FastAPI, Response

from foundation.live.wire import MEDIA_TYPE, Series, counters, exposition
from protocol.channel import LinkStatistics
from vision_pc.application.application import VisionApplication
from vision_pc.shell.rest.state_view import arm_json, link_view

_OF_THE_CONTROLLER = (
    "cycle",
    "plant_link_ok",
    "emergency_latched",
    "settled",
    "references_lost",
    "references_dropped",
    "supply_bar",
)
_DATAGRAMS = [field.name for field in fields(LinkStatistics) if field.name != "longest_gap"]

METRICS = (
    Series("memory_mb", "resident_memory_bytes", "Memory in use.", 1e6),
    *counters("link", "link_datagrams", _DATAGRAMS, "Datagrams from the controller: {}."),
    Series("link.longest_gap", "link_longest_gap_datagrams", "Most datagrams lost in a row."),
    Series(
        "reference_link.connected",
        "link_connected",
        "1: a session is open; a state and the clock have come in it.",
    ),
    Series(
        "reference_link.authenticated", "link_authenticated", "1: every datagram of the session is signed."
    ),
    Series("reference_link.state_age_ms", "link_state_age_seconds", "Since the newest state.", 1e-3),
    Series(
        "reference_link.clock.offset_ns",
        "link_clock_offset_seconds",
        "The controller's clock minus this.",
        1e-9,
    ),
    Series(
        "reference_link.clock.uncertainty_ns", "link_clock_uncertainty_seconds", "Bound on its error.", 1e-9
    ),
    Series("reference_link.clock.round_trip_us", "link_round_trip_seconds", "The newest heartbeat's.", 1e-6),
    Series("camera.connected", "camera_connected", "1: the camera delivers."),
    Series("camera.age_ms", "camera_frame_age_seconds", "Since the newest pair was captured.", 1e-3),
    Series("camera.rate_hz", "camera_frame_rate_hertz", "Pairs a second."),
    Series("camera.frames", "camera_frames_total", "Pairs delivered."),
    Series("camera.dropped", "camera_frames_dropped_total", "Pairs that were numbered and never came."),
    Series("camera.heard_at_s", "camera_newest_timestamp_seconds", "When the newest pair came, since 1970."),
    Series("camera.reconnects", "camera_reconnects_total", "Connections after the first."),
    Series("rest_refused", "rest_refused_total", "Requests refused, by cause.", label="cause"),
    Series("recording.written", "recording_messages_total", "Messages in the recording."),
    Series("recording.dropped", "recording_dropped_total", "Messages that the disk left no room for."),
    Series("recording.frames_missed", "recording_frames_missed_total", "Frames left out: too many waited."),
    Series("looks", "looks_total", "Looks taken."),
    Series("look.error_m", "look_error_meters", "What the newest look told, by camera axis.", label="axis"),
    Series("look.std_m", "look_error_std_meters", "Its standard deviation as told.", label="axis"),
    Series("log_lines_dropped", "log_lines_dropped_total", "Lines of the log that stderr did not take."),
    Series("live_dropped", "live_dropped_total", "Messages for viewers that made room for newer ones."),
    Series("controller.cycle.count", "controller_scans_total", "Scans, as the controller's state tells."),
    Series("controller.cycle.overruns", "controller_scan_overruns_total", "Scans left out, as it tells."),
    Series(
        "controller.cycle.lateness_p50_us",
        "controller_scan_lateness_median_seconds",
        "Of its last second.",
        1e-6,
    ),
    Series(
        "controller.cycle.lateness_p99_us",
        "controller_scan_lateness_p99_seconds",
        "Of its last second.",
        1e-6,
    ),
    Series(
        "controller.cycle.lateness_max_us", "controller_scan_lateness_max_seconds", "Since its start.", 1e-6
    ),
    Series(
        "controller.cycle.plant_exchange_failures",
        "controller_plant_exchange_failures_total",
        "Exchanges with the plant that failed, as it tells.",
    ),
    Series("controller.plant_link_ok", "controller_plant_link_ok", "1: the plant answers it."),
    Series(
        "controller.emergency_latched", "controller_emergency_latched", "1: an emergency stop is latched."
    ),
    Series("controller.settled", "controller_settled", "1: the arm has settled."),
    Series(
        "controller.references_lost", "controller_references_lost_total", "Datagrams that never came to it."
    ),
    Series(
        "controller.references_dropped",
        "controller_references_dropped_total",
        "Datagrams that it did not use.",
    ),
    Series("controller.supply_bar", "controller_supply_pressure_pascals", "Supply, as it measures.", 1e5),
)


def metrics_text(application: VisionApplication) -> str:
    """Its text for Prometheus; without a controller what that tells is left out."""
    controller = application.controller
    metrics = dict(application.metrics()) | {"looks": application.looks}
    if application.newest_look is not None:
        verdict = application.newest_look.verdict
        metrics["look"] = {
            "error_m": dict(zip("xyz", verdict.error_m.tolist(), strict=True)),
            "std_m": dict(zip("xyz", verdict.std_m.tolist(), strict=True)),
        }
    metrics["reference_link"] = link_view(controller).model_dump(
        exclude={"controller", "datagrams", "dropped"}
    )
    if controller.connected:
        arm = arm_json(controller.state)
        metrics["controller"] = {name: arm[name] for name in _OF_THE_CONTROLLER}
    return exposition("vision_pc", METRICS, metrics)


def add_metrics(app: FastAPI, application: VisionApplication) -> None:
    """Add the address; it is none of the API's that clients rely on, and not in its document."""

    @app.get("/metrics", include_in_schema=False)
    async def metrics() -> Response:
        """Always answered: without a controller its own figures are left out."""
        return Response(metrics_text(application), media_type=MEDIA_TYPE)
