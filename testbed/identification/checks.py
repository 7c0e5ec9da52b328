"""What is wrong with a recording, if anything: each fault named with its place, value and limit."""

from typing import NamedTuple

import numpy as np

from plant_emulator.config.actuators import BAR
from plant_emulator.core.layout import JOINTS
from protocol.errors import ConfigurationError
from testbed.identification.recording import COLUMNS, Array, MotionRecording

LEAST_FIT_S = 4.0
LEAST_HELD_OUT_S = 2.0
MOST_PERIOD_S = 0.05
_UNEVEN = 0.2  # of the period
_MOVED_RAD = 2e-3
_LIVE_BAR = 0.3  # a chamber of a joint that moves changes by more
_STILL_RAD_S = 1e-3
_WAIT_S = 0.1  # after which a joint has followed its valve


class Machine(NamedTuple):
    """What a recording must be of: the arm's name, the hash of its nominal model, the set of its valves."""

    arm: str
    arm_hash: str
    valve_set: str


def check_recording(recording: MotionRecording, machine: Machine) -> list[int]:
    """The joints (0 to 5) that a recording moves by their valves, and that can be identified from it.

    Raises ConfigurationError for a recording of another machine, or one that cannot serve.
    """
    check_machine(recording, machine)
    check_samples(recording)
    return excited_joints(recording.part(0.0, recording.about.held_out_from_s))


def check_machine(recording: MotionRecording, machine: Machine) -> None:
    """Raise ConfigurationError when ``recording`` is of another arm or of other valves than ``machine``."""
    about = recording.about
    if (about.arm_hash, about.valve_set) == (machine.arm_hash, machine.valve_set):
        return
    what = "arm" if about.arm_hash != machine.arm_hash else "valve_set"
    raise ConfigurationError(
        f"recording.other_{what}",
        f"{what}: the recording is of '{about.arm}' ({about.arm_hash}) with {about.valve_set} valves,"
        f" the configuration of '{machine.arm}' ({machine.arm_hash}) with {machine.valve_set} valves",
    )


def check_samples(recording: MotionRecording) -> None:
    """Raise ConfigurationError for numbers that are not finite, times that do not go on, too little of it."""
    t = recording.time_s
    _check_finite(recording)
    steps = np.diff(t)
    back = np.flatnonzero(steps <= 0.0)
    if len(back):
        k = int(back[0])
        raise ConfigurationError(
            "recording.not_monotone", f"time_s: {t[k + 1]:g} follows {t[k]:g} at sample {k + 1}"
        )
    about = recording.about
    fit_s = min(about.held_out_from_s, float(t[-1])) if len(t) else 0.0
    left_s = float(t[-1]) - about.held_out_from_s if len(t) else 0.0
    if fit_s < LEAST_FIT_S or left_s < LEAST_HELD_OUT_S:
        raise ConfigurationError(
            "recording.too_short",
            f"{fit_s:.1f} s to fit and {max(left_s, 0.0):.1f} s held out,"
            f" wanted at least {LEAST_FIT_S:g} and {LEAST_HELD_OUT_S:g}",
        )
    period = recording.period_s
    if period > MOST_PERIOD_S:
        raise ConfigurationError(
            "recording.too_slow", f"a sample every {1e3 * period:.1f} ms, at most {1e3 * MOST_PERIOD_S:g}"
        )
    uneven = np.flatnonzero(np.abs(steps - period) > _UNEVEN * period)
    if len(uneven):
        k = int(uneven[0])
        raise ConfigurationError(
            "recording.uneven",
            f"time_s: {1e3 * steps[k]:.2f} ms after sample {k}, usual are {1e3 * period:.2f}",
        )
    _check_rest(recording)


def _check_finite(recording: MotionRecording) -> None:
    n = len(recording.time_s)
    parts = (recording.time_s, recording.valves, recording.angles, recording.pressures, recording.supply)
    table = np.column_stack([part.reshape(n, -1) for part in (*parts, recording.oil_degc)])
    wrong = np.argwhere(~np.isfinite(table))
    if len(wrong):
        k, column = wrong[0]
        raise ConfigurationError(
            "recording.not_finite",
            f"{COLUMNS[column]} = {table[k, column]} at sample {k}, one of {len(wrong)} such values",
        )


def _check_rest(recording: MotionRecording) -> None:
    rest = recording.time_s < recording.time_s[0] + recording.about.rest_s
    open_by = float(np.abs(recording.valves[rest]).max(initial=0.0))
    if open_by > 0.0:
        raise ConfigurationError(
            "recording.no_rest",
            f"rest_s = {recording.about.rest_s:g}: a valve word of {open_by:g} in that time",
        )


def excited_joints(recording: MotionRecording) -> list[int]:
    """The joints that their valves move. Raises ConfigurationError for none, or one that moves wrongly.

    A joint counts when its valve word changes and its angle with it.
    """
    told = np.ptp(recording.valves, axis=0)
    moved = np.ptp(recording.angles, axis=0)
    joints = [j for j in range(len(JOINTS)) if told[j] > 0.0 and moved[j] > _MOVED_RAD]
    if not joints:
        most = int(np.argmax(moved))
        raise ConfigurationError(
            "recording.no_excitation",
            f"no joint is moved by its valve: at most {JOINTS[most]} by {1e3 * moved[most]:.2f} mrad"
            f" (wanted {1e3 * _MOVED_RAD:g}), its valve word by {told[most]:.4f} (wanted more than 0)",
        )
    for joint in joints:
        _check_joint(recording, joint)
    return joints


def _check_joint(recording: MotionRecording, joint: int) -> None:
    ranges = np.ptp(recording.pressures[:, joint], axis=0) / BAR
    if ranges.min() < _LIVE_BAR:
        side = "ab"[int(np.argmin(ranges))]
        raise ConfigurationError(
            "recording.no_pressures",
            f"pressure_{JOINTS[joint]}_{side}_bar stands still ({ranges.min():.3f} bar), the joint moves",
        )
    if (share := _right_way(recording, joint)) < 0.5:
        raise ConfigurationError(
            "recording.wrong_way",
            f"{JOINTS[joint]} follows the sign of its valve word in {100.0 * share:.0f} % of its motion:"
            " valve or encoder is swapped",
        )


def _right_way(recording: MotionRecording, joint: int) -> float:
    """The share of a joint's motion, by angle, that has the sign of the valve word that was in force."""
    lag = max(round(_WAIT_S / recording.period_s), 1)
    word = recording.valves[:-lag, joint]
    held = np.abs(word) >= 0.25 * np.abs(word).max()
    turned: Array = np.diff(recording.angles[:, joint])[lag - 1 :][: len(word)]
    fast = held[: len(turned)] & (np.abs(turned) > _STILL_RAD_S * recording.period_s)
    with_it = np.abs(turned[fast & (np.sign(turned) == np.sign(word[: len(turned)]))]).sum()
    return float(with_it / max(np.abs(turned[fast]).sum(), 1e-12))
