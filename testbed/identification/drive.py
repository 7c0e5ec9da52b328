"""The valves' electronics between a recording's words and the plant's next step.

The plant takes a word at its next step, but a prediction must change smoothly with the delay. So the delay's
whole steps are left to the plant, and the part of a step is made up for by the word of one step. Hysteresis,
which does not care about time, is applied to the words beforehand.
"""

from typing import NamedTuple

import numpy as np

from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES, JointValveConfig
from testbed.identification.recording import Array


class Drive(NamedTuple):
    """``rest``: the plant without what is done here; then delay beyond whole steps, and half the hysteresis.

    ``out`` and ``back`` are the slew limits (1/s) away from the centre and towards it; each is (6,).
    """

    rest: PlantConfig
    late_s: Array
    half_loop: Array
    out: Array
    back: Array

    def targets(self, words: Array) -> Array:
        """Where the spools are sent (n, 6) by ``words`` (n, 6): these, with the play of the hysteresis."""
        sent, now = np.empty_like(words), np.zeros(words.shape[1])
        for k, word in enumerate(np.clip(words, -1.0, 1.0)):
            now = np.clip(now, word - self.half_loop, word + self.half_loop)
            sent[k] = now
        return sent

    def after_a_part(self, before: Array, now: Array) -> Array:
        """The words (6,) of one step that stand for ``now`` coming a part of a step after its beginning.

        The plant ramps at its slew limit L from ``before``. A ramp that begins f h late falls short by the
        impulse Δ f h + Δ²/(2L) of the step Δ; one that goes to u in the first step of h, and on from there,
        by Δ h + Δ²/(2L) − u (h + Δ/L) + u²/L. Both are the same for the u that is returned.
        """
        h = 1e-3 * self.rest.step_ms
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
    joints = {
        name: (config.valves.joints.get(name) or JointValveConfig()).model_copy(
            update={"delay_ms": float(steps) * config.step_ms, "hysteresis": 0.0}
        )
        for name, steps in zip(JOINT_NAMES, whole, strict=True)
    }
    valves = config.valves.model_copy(update={"joints": joints})
    return Drive(
        config.model_copy(update={"valves": valves}),
        np.maximum(delays - whole, 0.0) * 1e-3 * config.step_ms,
        np.array([0.5 * valve.hysteresis for valve in six]),
        np.array([valve.slew_out_per_s for valve in six]),
        np.array([valve.slew_back_per_s for valve in six]),
    )
