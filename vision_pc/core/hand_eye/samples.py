"""Pose pairs as a hand-eye solver takes them: checked one by one, in an order that no caller can influence.

Frames: B base, T tool (the hand), C camera, P pattern (the calibration target). One sample is the pose of the
tool in the base, X_BT, and the pose of the pattern in the camera, X_CP.
The pattern is fixed in the base and the camera in the hand (eye in hand), or the other way round (eye to
hand):

    eye in hand:  X_BT X_TC X_CP = X_BP        unknown X = X_TC, Z = X_BP
    eye to hand:  X_TB X_BC X_CP = X_TP        unknown X = X_BC, Z = X_TP

Both are H X P = Z with H = X_BT or its inverse, and P = X_CP; the solvers know only that form.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.errors import RequestRefused
from vision_pc.config.choices import Setup
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.se3 import Array, nearest_rotation

_LONGEST_M = 20.0  # questions the unit of a translation
_SKEW = 2e-3  # [E] of the largest entry of RᵀR − I: four printed decimals pass
_SAME = 1e-7  # m, and entries of R: two camera poses closer than this are one and the same measurement
_STILL_M, _STILL = 1e-3, 2e-3  # if the hand moved meanwhile by these the camera did not follow
# All samples of a hand at rest within these that are seen the same within those are one moment.
_REST_M, _REST, _SEEN_M, _SEEN = 5e-5, 1e-4, 1e-3, 3e-3


class CornerViews(NamedTuple):
    """The target's points as each picture shows them: what the lens is wrong by moves them.

    ``points_P`` (m, 3) metres in the pattern's axes; ``pixels`` (n, m, 2), NaN where a point was not seen;
    ``K`` (3, 3) px and ``distortion`` (k,) of the camera (OpenCV's order).
    """

    points_P: Array
    pixels: Array
    K: Array
    distortion: Array


@dataclass(frozen=True, eq=False)
class PosePairs:
    """Checked samples in canonical order. Build them with ``pose_pairs``.

    ``H`` and ``P`` are (n, 4, 4) of the form H X P = Z; ``names`` are the caller's, in the same order;
    ``order[k]`` is the caller's position of sample k. ``copies``: samples that were left out, as hand and
    camera stood as in another.
    """

    setup: Setup
    H: Array
    P: Array
    names: tuple[str, ...]
    order: tuple[int, ...]
    corners: CornerViews | None = None
    copies: int = 0

    def __len__(self) -> int:
        return len(self.names)

    @property
    def X_BT(self) -> Array:
        """The poses of the hand in the base (n, 4, 4)."""
        return self.H if self.setup is Setup.EYE_IN_HAND else stacks.inverse(self.H)

    def subset(self, keep: NDArray[np.bool_]) -> "PosePairs":
        """The samples whose flag in ``keep`` (n,) is set, still in canonical order."""
        chosen = np.flatnonzero(keep)
        corners = self.corners and self.corners._replace(pixels=self.corners.pixels[chosen])
        names = tuple(self.names[k] for k in chosen)
        return PosePairs(
            self.setup, self.H[chosen], self.P[chosen], names, tuple(range(len(chosen))), corners
        )


def pose_pairs(
    X_BT: Array,
    X_CP: Array,
    setup: Setup = Setup.EYE_IN_HAND,
    names: tuple[str, ...] | None = None,
    corners: CornerViews | None = None,
) -> PosePairs:
    """The samples, checked, with exactly orthonormal rotations, in canonical order.

    ``X_BT``, ``X_CP`` (n, 4, 4): tool in base, pattern in camera, metres. Raises RequestRefused naming the
    sample: ``refused.hand_eye.not_finite``, ``.not_a_pose``, ``.left_handed``,
    ``.not_orthonormal``, ``.units``, ``.duplicate``, ``.stale_camera``.
    """
    hand, target = np.asarray(X_BT, dtype=np.float64), np.asarray(X_CP, dtype=np.float64)
    names = names or tuple(str(k + 1) for k in range(len(hand)))
    for what, stack in (("hand", hand), ("camera", target)):
        for name, X in zip(names, stack, strict=True):
            check_pose(X, f"sample {name}: {what} pose")
    hand, target = (stacks.transform(nearest_rotation(X[:, :3, :3]), X[:, :3, 3]) for X in (hand, target))
    _check_repeats(hand, target, names)
    flat = np.concatenate([hand[:, :3].reshape(len(hand), 12), target[:, :3].reshape(len(hand), 12)], axis=1)
    order = np.lexsort(flat.T[::-1])
    H = hand if setup is Setup.EYE_IN_HAND else stacks.inverse(hand)
    return PosePairs(
        setup,
        H[order],
        target[order],
        tuple(names[k] for k in order),
        tuple(int(k) for k in order),
        corners and corners._replace(pixels=corners.pixels[order]),
    )


def distinct(X_BT: Array, X_CP: Array) -> NDArray[np.bool_]:
    """Which samples (n, 4, 4) are moments of their own: the first of those at which hand and camera stand
    still. Pictures of one moment share the errors of arm and target; counted apart they make σ too small.
    """
    first = np.ones(len(X_BT), dtype=bool)
    for k in range(1, len(X_BT)):
        hand = _same(X_BT[k], X_BT[:k][first[:k]], _REST_M, _REST)
        camera = _same(X_CP[k], X_CP[:k][first[:k]], _SEEN_M, _SEEN)
        first[k] = not bool(np.any(hand & camera))
    return first


def check_pose(X: Array, where: str, longest_m: float = _LONGEST_M) -> None:
    """Raises RequestRefused as ``pose_pairs`` for what is no pose (4, 4) in metres that stands ``where``."""
    if not np.isfinite(X).all():
        raise RequestRefused("refused.hand_eye.not_finite", f"{where} holds a number that is not finite")
    if np.abs(X[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-9:
        why = "" if X[:3, 3].any() else "; is it written by columns?"
        raise RequestRefused(
            "refused.hand_eye.not_a_pose", f"{where}: last row is {X[3].tolist()}, not 0 0 0 1{why}"
        )
    R, p = X[:3, :3], X[:3, 3]
    defect = float(np.abs(R.T @ R - np.eye(3)).max())
    if np.linalg.det(R) < 0.0:
        raise RequestRefused(
            "refused.hand_eye.left_handed", f"{where}: rotation is left-handed (det {np.linalg.det(R):.3f})"
        )
    if defect > _SKEW:
        raise RequestRefused(
            "refused.hand_eye.not_orthonormal",
            f"{where}: rotation is off orthonormal by {defect:.2g}, limit {_SKEW:g}",
        )
    if np.abs(p).max() > longest_m:
        raise RequestRefused(
            "refused.hand_eye.units",
            f"{where}: translation {np.abs(p).max():g} m, limit {longest_m:g} m; in millimetres?",
        )


def _check_repeats(hand: Array, target: Array, names: tuple[str, ...]) -> None:
    """Refuse samples given twice, and camera poses that stayed the very same while the hand moved."""
    for i in range(len(hand) - 1):
        for j in i + 1 + np.flatnonzero(_same(target[i], target[i + 1 :], _SAME, _SAME)):
            pair = f"samples {names[i]} and {names[j]}"
            if _same(hand[i], hand[j], _STILL_M, _STILL):
                raise RequestRefused("refused.hand_eye.duplicate", f"{pair} are the same sample twice")
            raise RequestRefused(
                "refused.hand_eye.stale_camera",
                f"{pair}: the hand moved but the camera pose is the very same",
            )


def _same(X: Array, Y: Array, within_m: float, within: float) -> NDArray[np.bool_]:
    gap = np.abs(X - Y)
    same: NDArray[np.bool_] = (gap[..., :3, 3].max(axis=-1) < within_m) & (
        gap[..., :3, :3].max(axis=(-2, -1)) < within
    )
    return same
