"""The compiled plant along a whole recording in one call: what `free_run` prepares, `run` integrates.

Between two samples nothing is decided in Python: a run of the plant costs what its right-hand sides cost.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES
from plant_emulator.core.layout import DRIVEN, N_ACTUATORS, PRESSURE_A, PRESSURE_B, RATE, SUPPLY, Q
from plant_emulator.core.model import Model
from plant_emulator.core.right_hand_side import EncoderShafts, Work, advance
from testbed.identification.recording import Array, MotionRecording

Counts = NDArray[np.int64]

N_SIGNALS = 3 * N_ACTUATORS + 1
"""Of a prediction: six angles (rad), chambers a and b of each joint (Pa), supply (Pa)."""
_JOINT = np.array(DRIVEN)  # compiled code indexes an array, not a tuple, with a variable


class Words(NamedTuple):
    """Spool words of n samples: ``first`` (n, 6) in a sample's first step, ``held`` (n, 6) from then on.

    ``late`` (6,): how many steps after the sample each joint's valve takes them. ``at`` (n,): the step that
    each sample begins with. ``drive``, ``target`` and ``sample`` (6,) are scratch, and begin at zero.
    """

    held: Array
    first: Array
    late: Counts
    at: Counts
    drive: Array
    target: Array
    sample: Counts


class Restarts(NamedTuple):
    """The measured state of n samples, put into the plant at every ``every``-th; 0: never.

    ``offsets`` (6,) are the encoders' zeros (rad), which predictions carry as well.
    """

    every: int
    offsets: Array
    angles: Array  # (n, 6) rad
    rates: Array  # (n, 6) rad/s
    pressures: Array  # (n, 6, 2) Pa
    supply: Array  # (n,) Pa


@allocation_free
def spool_words(words: Array, half_loop: Array, sent: Array) -> None:
    """Fill ``sent`` (n, 6) with where ``words`` (n, 6) send the spools, their hysteresis being a play."""
    for i in range(words.shape[1]):
        now = 0.0
        for k in range(words.shape[0]):
            word = min(max(words[k, i], -1.0), 1.0)
            now = min(max(now, word - half_loop[i]), word + half_loop[i])
            sent[k, i] = now


@allocation_free
def _restart(state: Array, shaft: Array, k: int, restarts: Restarts) -> None:
    """Put what the sensors tell at sample ``k`` into the plant; play and bristles stay as they are."""
    for i in range(N_ACTUATORS):
        shift = restarts.angles[k, i] - restarts.offsets[i] - shaft[i]
        shaft[i] += shift
        state[Q + _JOINT[i]] += shift
        state[RATE + _JOINT[i]] = restarts.rates[k, i]
        state[PRESSURE_A + i] = restarts.pressures[k, i, 0]
        state[PRESSURE_B + i] = restarts.pressures[k, i, 1]
    state[SUPPLY] = restarts.supply[k]


@allocation_free
def _read_signals(state: Array, shaft: Array, offsets: Array, signals: Array, k: int) -> None:
    for i in range(N_ACTUATORS):
        signals[k, i] = shaft[i] + offsets[i]
        signals[k, N_ACTUATORS + 2 * i] = state[PRESSURE_A + i]
        signals[k, N_ACTUATORS + 2 * i + 1] = state[PRESSURE_B + i]
    signals[k, 3 * N_ACTUATORS] = state[SUPPLY]


@allocation_free
def _target(words: Words, step: int) -> None:
    """Fill ``words.target`` with what the valves have taken by ``step``."""
    for i in range(N_ACTUATORS):
        now, k = step - words.late[i], words.sample[i]
        if now < 0:
            continue
        while k + 1 < words.at.shape[0] and words.at[k + 1] <= now:
            k += 1
        words.sample[i] = k
        words.target[i] = words.first[k, i] if now == words.at[k] else words.held[k, i]


@allocation_free
def run(
    state: Array,
    shafts: EncoderShafts,
    words: Words,
    restarts: Restarts,
    h: float,
    model: Model,
    work: Work,
    signals: Array,
) -> None:
    """Fill ``signals`` (n, N_SIGNALS) from ``state`` on, in steps of ``h`` (s) along ``words``."""
    n = words.at.shape[0]
    for k in range(n):
        if restarts.every > 0 and k > 0 and k % restarts.every == 0:
            _restart(state, shafts.angle, k, restarts)
        _read_signals(state, shafts.angle, restarts.offsets, signals, k)
        if k + 1 < n:
            for step in range(words.at[k], words.at[k + 1]):
                _target(words, step)
                advance(state, words.drive, words.target, shafts, 1, h, model, work)


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
