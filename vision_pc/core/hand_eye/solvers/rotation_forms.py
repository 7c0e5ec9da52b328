"""Rotations that were written in one convention and read in another: three numbers, composed otherwise.

What was read is taken apart by the convention that it was read in, and put together by the one that it was
written in. The numbers are ambiguous: an Euler order has two triples for a rotation, a rotation vector may be
a turn longer. Of both, that is chosen in which the hand turns between samples as far as the camera does.
"""

import warnings
from collections.abc import Iterator
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from vision_pc.core import se3_stacks as stacks
from vision_pc.core.se3 import Array

# Capitals: about axes that turn along, in the order of the numbers; small letters: about fixed ones.
_EULER: dict[str, Literal["ZYX", "XYZ", "ZYZ", "xyz"]] = {
    "Z Y X": "ZYX",
    "X Y Z": "XYZ",
    "Z Y Z": "ZYZ",
    "roll pitch yaw about fixed axes": "xyz",
}
_VECTOR = "a rotation vector"
_AGREE = np.radians(3.0)  # what turns may differ by, in the middle, for a reading to be looked at
_ROUNDS = 5


def reread(R: Array, turned: Array) -> Iterator[tuple[str, Array]]:
    """Other rotations (n, 3, 3) that the numbers behind ``R`` (n, 3, 3) may mean, and in words what was taken
    for what; those alone whose angles between samples are near ``turned`` (n, n) rad.
    """
    ways: list[tuple[str, Array]] = []
    for read in (*_EULER, _VECTOR):
        numbers = _numbers(R, read)
        ways += [
            (f"are {written}, read as {read}", _composed(numbers, written))
            for written in (*_EULER, _VECTOR)
            if written != read
        ]
        ways.append((f"are radians, read as degrees of {read}", _composed(np.degrees(numbers), read)))
    for words, candidates in ways:
        chosen, off = _chosen(candidates, turned)
        if off < _AGREE:
            yield words, chosen


def angles_between(R: Array) -> Array:
    """The angles (n, n) rad by which rotations (n, 3, 3) differ."""
    return np.asarray(stacks.angle(np.swapaxes(R, -1, -2)[:, None] @ R[None]))


def _numbers(R: Array, read: str) -> Array:
    """Both triples (2, n, 3) rad that ``read`` makes into ``R``."""
    rotation = Rotation.from_matrix(R)
    if read == _VECTOR:
        v = rotation.as_rotvec()
        length = np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9)
        return np.stack([v, v * (1.0 - 2.0 * np.pi / length)])
    order = _EULER[read]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # gimbal lock: one of its many triples will do
        found = rotation.as_euler(order)
    middle = -found[:, 1] if order[0] == order[2] else np.pi - found[:, 1]
    other = np.stack([found[:, 0] + np.pi, middle, found[:, 2] + np.pi], axis=-1)
    return np.asarray(np.remainder(np.stack([found, other]) + np.pi, 2.0 * np.pi) - np.pi)


def _composed(numbers: Array, written: str) -> Array:
    """The rotations (2, n, 3, 3) that triples (2, n, 3) rad mean."""
    flat = numbers.reshape(-1, 3)
    made = Rotation.from_rotvec(flat) if written == _VECTOR else Rotation.from_euler(_EULER[written], flat)
    return np.asarray(made.as_matrix().reshape(*numbers.shape[:-1], 3, 3))


def _chosen(candidates: Array, turned: Array) -> tuple[Array, float]:
    """Of both rotations (2, n, 3, 3) for each sample those that fit ``turned`` (n, n) best, and the median of
    what they are off (rad).
    """
    n = candidates.shape[1]
    relative = np.swapaxes(candidates, -1, -2)[:, :, None, None] @ candidates[None, None]
    off = np.abs(stacks.angle(relative) - turned[None, :, None, :])  # (2, n, 2, n)
    best: tuple[Array, float] | None = None
    for start in (0, 1):
        pick = np.argmin(off[:, :, start, 0], axis=0)
        pick[0] = start
        for _ in range(_ROUNDS):
            cost = np.median(off[:, :, pick, np.arange(n)], axis=-1)  # (2, n)
            pick = np.argmin(cost, axis=0)
        residual = float(np.median(off[pick, np.arange(n)][:, pick, np.arange(n)]))
        if best is None or residual < best[1]:
            best = candidates[pick, np.arange(n)], residual
    assert best is not None
    return best
