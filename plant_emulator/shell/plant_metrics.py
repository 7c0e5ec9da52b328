"""What the emulator's statistics are called where Prometheus reads them."""

from foundation.live.wire import Series, counters
from plant_emulator.core.coupler.answers import COUNTED

_PROCESSES = {"plant": "", "renderer": "renderer_", "fault_api": "fault_api_"}
_FRAMES = {
    "frames_rendered": "Pairs rendered.",
    "frames_skipped": "Captures that were not rendered: the renderer was busy.",
    "frames_unwatched": "Captures that nobody would have received.",
    "frames_sent": "Pairs sent, over all clients.",
    "frames_dropped_slow": "Pairs that a client was too slow for.",
    "clients_displaced": "Clients that made room for others.",
    "captures_missed": "Captures that came too late.",
    "poses_dropped": "Captures that the renderer did not take.",
    "frames_lost_on_purpose": "Pairs that a fault or the scene lost.",
}

METRICS = (
    Series("period_ms", "step_period_seconds", "Configured time between two steps.", 1e-3),
    Series("integrator.periods_served", "steps_total", "Steps of the physics."),
    Series("integrator.periods_missed", "steps_missed_total", "Steps in which simulated time stood still."),
    Series("integrator.late_max_us", "step_lateness_max_seconds", "The latest step.", 1e-6),
    Series("simulated_s", "simulated_seconds_total", "Simulated time."),
    *counters("coupler", "coupler", COUNTED, "Of the bus coupler: {}."),
    *(Series(f"camera.{key}", f"camera_{key}_total", text) for key, text in _FRAMES.items()),
    Series("camera.clients", "camera_clients", "Clients of the camera stream."),
    Series(
        "camera.render_cpu_p50_ms", "camera_render_median_seconds", "Processor time of a pair, median.", 1e-3
    ),
    Series(
        "camera.render_cpu_p99_ms",
        "camera_render_p99_seconds",
        "Processor time of a pair, 99th percentile.",
        1e-3,
    ),
    Series("truth_records", "recording_messages_total", "Messages in the recording."),
    Series("truths_dropped", "recording_dropped_total", "Messages that the disk left no room for."),
    *(
        Series(f"memory.{of}_rss_mb", f"{prefix}resident_memory_bytes", f"Memory in use by {of}.", 1e6)
        for of, prefix in _PROCESSES.items()
    ),
    Series("oil_temperature_degc", "true_oil_temperature_celsius", "Truth: the oil."),
    Series("supply_pa", "true_supply_pressure_pascals", "Truth: the supply, absolute."),
    Series("log_lines_dropped", "log_lines_dropped_total", "Lines of the log that stderr did not take."),
    Series("live_dropped", "live_dropped_total", "Messages for viewers that made room for newer ones."),
)
