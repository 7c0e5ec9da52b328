"""What the controller knows of the plant from its images: joint angles and speeds, and whether the link is
alive.

The link counts as alive while good exchanges arrive, the plant's own cycle advances and the plant echoes the
controller's cycle; each of the three is watched in exchanges, and silence in time as well.
"""

import math
from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.servo.joint_control import pt1_step
from controller.core.settings import ScanSettings
from protocol.process_image import COUNTS_PER_TURN, CYCLE_MODULUS, SensorImage

RAD_PER_COUNT = 2.0 * math.pi / COUNTS_PER_TURN
# Another master owns the outputs, or the coupler is busy: it may pass, so it is asked again a few times.
_BUSY = 6
# Joint speeds for supervision only: long enough to hide the encoder's last digit, short against a fault.
_SPEED_FILTER_S = 0.03  # [D]


class PlantRefusal(NamedTuple):
    """The plant answered an exchange with this Modbus exception code, and took nothing of it."""

    code: int


class PlantWatch(NamedTuple):
    """``sensors``: the last good image, None before the first. ``qd_meas``: filtered joint speeds (rad/s).

    ``turned``: what the joints turned since the image before (rad), zero without a new one. ``missed``:
    failed exchanges in a row; ``frozen``: exchanges since the plant's cycle last advanced; ``echo_lag``:
    cycles by which its echo lags; ``silent_s``: time since the last good exchange; ``failures``: failed
    exchanges in all; ``refusal``: the exception code of the last exchange, None for none.
    """

    sensors: SensorImage | None
    q_meas: Array
    qd_meas: Array
    turned: Array
    missed: int
    frozen: int
    echo_lag: int
    silent_s: float
    failures: int
    refusal: int | None


def unseen() -> PlantWatch:
    """Before the first image."""
    return PlantWatch(None, np.zeros(6), np.zeros(6), np.zeros(6), 0, 0, 0, 0.0, 0, None)


def update_watch(
    watch: PlantWatch, sensors: SensorImage | PlantRefusal | None, cycle: int, dt_s: float
) -> PlantWatch:
    """``watch`` after one exchange; ``sensors`` None when it failed; ``cycle`` the last one that was sent."""
    if not isinstance(sensors, SensorImage):
        return watch._replace(
            turned=np.zeros(6),
            missed=watch.missed + 1,
            silent_s=watch.silent_s + dt_s,
            failures=watch.failures + 1,
            refusal=None if sensors is None else sensors.code,
        )
    q_meas = np.array(sensors.encoder_counts) * RAD_PER_COUNT
    before = watch.sensors
    if before is None:
        return PlantWatch(sensors, q_meas, np.zeros(6), np.zeros(6), 0, 0, 0, 0.0, watch.failures, None)
    turned = q_meas - watch.q_meas
    elapsed = dt_s + watch.silent_s
    keep = pt1_step(1.0, 0.0, _SPEED_FILTER_S, elapsed)
    return PlantWatch(
        sensors=sensors,
        q_meas=q_meas,
        qd_meas=keep * watch.qd_meas + (1.0 - keep) * turned / elapsed,
        turned=turned,
        missed=0,
        frozen=watch.frozen + 1 if sensors.plant_cycle == before.plant_cycle else 0,
        echo_lag=(cycle - sensors.echo_cycle) % CYCLE_MODULUS,
        silent_s=0.0,
        failures=watch.failures,
        refusal=None,
    )


def link_lost(settings: ScanSettings, watch: PlantWatch) -> tuple[float, float] | None:
    """Value and limit of what says that the plant does not hear or answer; None while it does."""
    limits = settings.supervision
    if watch.refusal not in (None, _BUSY):
        return float(watch.refusal), 0.0
    if watch.sensors is None:
        return float(watch.missed), 0.0
    if watch.missed > limits.missed_exchanges:
        return float(watch.missed), float(limits.missed_exchanges)
    if watch.silent_s > limits.silence:
        return watch.silent_s, limits.silence
    if watch.echo_lag > limits.echo_lag_cycles:
        return float(watch.echo_lag), float(limits.echo_lag_cycles)
    return None


def cycle_frozen(settings: ScanSettings, watch: PlantWatch) -> tuple[float, float] | None:
    """Value and limit of a plant that answers but stands still; None while its cycle advances."""
    limit = settings.supervision.frozen_exchanges
    return (float(watch.frozen), float(limit)) if watch.frozen > limit else None
