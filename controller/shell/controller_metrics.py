"""What the controller's statistics are called where Prometheus reads them."""

from dataclasses import fields

from foundation.live.wire import Series, counters
from protocol.channel import LinkStatistics

_DATAGRAMS = [field.name for field in fields(LinkStatistics) if field.name != "longest_gap"]

METRICS = (
    Series("cycle_ms", "scan_period_seconds", "Configured time between two scans.", 1e-3),
    Series("cycles", "scans_total", "Scans run."),
    Series("overruns", "scan_overruns_total", "Scans that were left out because the one before was late."),
    Series("late_max_us", "scan_lateness_max_seconds", "The latest scan since the start.", 1e-6),
    Series("scan_max_us", "scan_duration_max_seconds", "The longest computation of a scan.", 1e-6),
    Series("plant_exchanges", "plant_exchanges_total", "Exchanges with the plant that were answered."),
    Series("round_trip_max_us", "plant_round_trip_max_seconds", "The longest exchange.", 1e-6),
    Series(
        "plant_exchange_failures",
        "plant_exchange_failures_total",
        "Exchanges that failed, by cause.",
        label="cause",
    ),
    Series("plant_connections", "plant_connections_total", "Connections made to the plant."),
    Series("images_refused", "plant_images_refused_total", "Input images that could not be decoded."),
    Series("scan_records", "recording_messages_total", "Messages in the recording."),
    Series("scan_records_dropped", "recording_dropped_total", "Messages that the disk left no room for."),
    *counters("reference_link", "reference_link_datagrams", _DATAGRAMS, "Datagrams from the vision PC: {}."),
    Series(
        "reference_link.longest_gap", "reference_link_longest_gap_datagrams", "Most datagrams lost in a row."
    ),
    Series(
        "reference_link.flooded",
        "reference_link_flooded_scans_total",
        "Scans with more than they could read.",
    ),
    Series("rss_mb", "resident_memory_bytes", "Memory in use.", 1e6),
    Series("log_lines_dropped", "log_lines_dropped_total", "Lines of the log that stderr did not take."),
    Series("live_dropped", "live_dropped_total", "Messages for viewers that made room for newer ones."),
)
