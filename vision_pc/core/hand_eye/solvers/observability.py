"""Can these samples determine X at all? A verdict before any number is given out.

Rotation about one axis only leaves the position along it free; too little rotation leaves everything to
noise. Both show in the scatter of the motions' rotation vectors: its second root-mean-square says how far
the hand turned about any axis other than the main one.
"""

import math
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.solvers.motions import Motions
from vision_pc.core.se3 import Array


class ObservabilityLimits(NamedTuple):
    """``samples`` at least; ``rotation`` at least between some two samples (rad).

    About axes other than the main one the hand must turn ``second_axis`` rms at least (rad),
    ``above_noise`` times the rotation noise that the motions show, and enough that this noise, averaged
    over the samples, leaves the rotation of X known to ``uncertainty`` (rad). Where it forbids an answer and
    is above ``strangers``, it is no noise: whatever X is, hand and camera turn by equal angles.
    """

    samples: int = 3
    rotation: float = math.radians(1.0)
    second_axis: float = math.radians(0.3)
    above_noise: float = 1.2
    uncertainty: float = 0.1
    strangers: float = math.radians(5.0)


class Observability(NamedTuple):
    """What the samples offer; ``cause`` is None when X can be determined, and ``reason`` says why.

    ``largest_rotation`` between two samples, ``second_axis`` rms about axes other than the main one,
    ``mismatch`` rms of the difference between hand's and camera's rotation angle (a measure of noise), rad.
    """

    samples: int
    largest_rotation: float
    second_axis: float
    mismatch: float
    cause: str | None
    reason: str

    def demand(self) -> None:
        """Raise MeasurementFailed with the reason when X cannot be determined."""
        if self.cause is not None:
            raise MeasurementFailed(self.cause, self.reason)


def verdict(samples: int, motions: Motions, limits: ObservabilityLimits | None = None) -> Observability:
    """Whether X can be determined from these ``samples`` and the ``motions`` between them."""
    limits = limits or ObservabilityLimits()
    if samples < limits.samples or not len(motions.A):
        reason = f"{samples} samples are too few: at least {limits.samples} are needed"
        return Observability(samples, 0.0, 0.0, 0.0, "measurement.hand_eye.too_few_samples", reason)
    hand, camera = stacks.log_so3(motions.A[:, :3, :3]), stacks.log_so3(motions.B[:, :3, :3])
    hand_angles = np.linalg.norm(hand, axis=-1)
    largest = float(hand_angles.max())
    second = min(_second_axis(hand), _second_axis(camera))
    difference = np.abs(hand_angles - np.linalg.norm(camera, axis=-1))
    mismatch = 1.4826 * float(np.median(difference))  # robust: a few bad samples do not count as noise
    cause, reason = None, "two or more axes, enough rotation"
    needed = max(
        limits.second_axis,
        limits.above_noise * mismatch,
        mismatch / (limits.uncertainty * math.sqrt(max(samples - 2, 1))),
    )
    if largest < limits.rotation:
        cause = "measurement.hand_eye.too_little_rotation"
        reason = (
            f"largest rotation between samples is {_deg(largest)}, at least {_deg(limits.rotation)} is needed"
        )
    elif limits.second_axis <= second < needed and mismatch > limits.strangers:
        cause = "measurement.hand_eye.motions_differ"
        reason = (
            f"hand and camera turn by different angles between the same samples, {_deg(mismatch)} apart, "
            f"limit {_deg(limits.strangers)}: their poses do not belong together"
        )
    elif second < needed:
        cause = "measurement.hand_eye.parallel_axes"
        reason = (
            f"rotation axes are parallel: only {_deg(second)} rms about a second axis, "
            f"{_deg(needed)} is needed; turn the hand about another axis too"
        )
    return Observability(samples, largest, second, mismatch, cause, reason)


def _second_axis(vectors: Array) -> float:
    """Rms rotation about the second of the principal axes."""
    return float(np.sqrt(max(np.linalg.eigvalsh(vectors.T @ vectors / len(vectors))[1], 0.0)))


def _deg(angle: float) -> str:
    return f"{math.degrees(angle):.2f} deg"
