"""The valves' electronics between a recording's words and the plant's next step.

The plant takes a word at its next step, but a prediction must change smoothly with the delay. So the part of
a step that a delay has beyond whole ones is made up for by the word of one step. Hysteresis, which does not
care about time, is applied to the words beforehand.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES
from plant_emulator.core.layout import N_ACTUATORS
from testbed.identification.compiled_run import Words, spool_words
from testbed.identification.recording import Array, MotionRecording


class Drive(NamedTuple):
    """Delay in whole steps and beyond them, half the hysteresis; each is (6,).

    ``out`` and ``back`` are the slew limits (1/s) away from the centre and towards it.
    """

    step_ms: float
    late_steps: NDArray[np.int64]
    late_s: Array
    half_loop: Array
    out: Array
    back: Array

    def along(self, recording: MotionRecording) -> Words:
        """What the spools are told along ``recording``, for its compiled run."""
        sent = np.empty_like(recording.valves)
        spool_words(recording.valves, self.half_loop, sent)
        before = np.vstack([np.zeros(N_ACTUATORS), sent[:-1]])
        steps = 1e3 * (recording.time_s - recording.time_s[0]) / self.step_ms
        return Words(
            held=sent,
            first=self.after_a_part(before, sent),
            late=self.late_steps,
            at=np.floor(steps + 1e-3).astype(np.int64),
            drive=np.zeros(N_ACTUATORS),
            target=np.zeros(N_ACTUATORS),
            sample=np.zeros(N_ACTUATORS, dtype=np.int64),
        )

    def after_a_part(self, before: Array, now: Array) -> Array:
        """The words (n, 6) of one step that stand for ``now`` coming a part of a step after its beginning.

        The plant ramps at its slew limit L from ``before``. A ramp that begins f h late falls short by the
        impulse Δ f h + Δ²/(2L) of the step Δ; one that goes to u in the first step of h, and on from there,
        by Δ h + Δ²/(2L) − u (h + Δ/L) + u²/L. Both are the same for the u that is returned.
        """
        h = 1e-3 * self.step_ms
        way = now - before
        size = np.abs(way)
        limit = np.where(np.abs(now) > np.abs(before), self.out, self.back)
        reach = h + size / limit
        left = np.maximum(reach**2 - 4.0 * size * (h - self.late_s) / limit, 0.0)
        first = before + np.sign(way) * 0.5 * limit * (reach - np.sqrt(left))
        return np.asarray(np.where(self.late_s > 0.0, first, now))


def drive_of(config: PlantConfig) -> Drive:
    """The electronics of the valves of ``config``."""
    six = [config.valves.of(name, 1.0) for name in JOINT_NAMES]
    delays = np.array([valve.delay_ms for valve in six]) / config.step_ms
    whole = np.floor(delays + 1e-9)
    return Drive(
        config.step_ms,
        whole.astype(np.int64),
        np.maximum(delays - whole, 0.0) * 1e-3 * config.step_ms,
        np.array([0.5 * valve.hysteresis for valve in six]),
        np.array([valve.slew_out_per_s for valve in six]),
        np.array([valve.slew_back_per_s for valve in six]),
    )
