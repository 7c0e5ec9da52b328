"""Limits of a controller beside other work: what is late there says nothing of the arm."""

PATIENT = (
    "controller.plant_link.timeout_ms=1000",
    "controller.supervision.overrun_ms=5000",
    "controller.supervision.silence_ms=5000",
    "controller.supervision.missed_exchanges=1000",
    "controller.supervision.encoder_jump_deg=45",
    "controller.supervision.overspeed_ms=1000",
    "controller.supervision.following_error_deg=[60,60,60,60,60,60]",
)
