"""The targets of a session: where they are in the camera now, and how that is known.

A target is measured where it can be seen. While the arm drives, odometry carries it from rest to rest. A
motion that nobody watched loses it: it must be clicked anew.
"""

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from protocol.errors import RequestRefused
from vision_pc.config.programs import TargetSettings
from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.core.targets.sighting import KnownTarget
from vision_pc.core.targets.target import Kind, TargetObservation, TargetRefused
from vision_pc.core.types import Image

_HALF = 20  # px of what is compared, on either side
_REACH = 18  # px it is looked for about its place; both together lie within the rim that no click may be in
_MOST_PX = 2.0  # [E] that a disabled arm sinks in the seconds that a picture is kept for
_LEAST = 0.5  # correlation below which something else is there
_MARGIN = 0.1  # by which another place must look more alike than its own


def refuse_moved(then: Image, now: Image, pixel: Array) -> None:
    """Raises TargetRefused (``target.moves``) where ``now`` shows at ``pixel`` (2,) not what ``then`` does.

    ``pixel`` is no nearer to the rim than a click may be, and was measured: there is something to compare.
    """
    u, v = np.rint(pixel).astype(int)
    wide = _HALF + _REACH
    template = _smooth(then[v - _HALF : v + _HALF + 1, u - _HALF : u + _HALF + 1])
    scores = cv2.matchTemplate(
        _smooth(now[v - wide : v + wide + 1, u - wide : u + wide + 1]), template, cv2.TM_CCOEFF_NORMED
    )
    row, column = np.unravel_index(int(scores.argmax()), scores.shape)
    best, moved = float(scores[row, column]), math.hypot(row - _REACH, column - _REACH)
    here = float(scores[_REACH - 2 : _REACH + 3, _REACH - 2 : _REACH + 3].max())
    if best < _LEAST:
        raise TargetRefused("target.moves", "target: something else is there by now")
    if moved > _MOST_PX and here < best - _MARGIN:
        raise TargetRefused("target.moves", f"target: what is there has moved by {moved:.0f} px since")


def _smooth(image: Image) -> Image:
    return np.asarray(cv2.GaussianBlur(image, (5, 5), 1.0), dtype=np.uint8)


Known = Literal["measured", "carried", "lost"]
MARKERS = "markers"  # in place of an id: the object's markers
_MOST = 100
_CARRIED_STD_M, _CARRIED_STD = 0.0002, 0.001  # [E] odometry from rest to rest, and of the way
_STILL = 0.003  # m or rad: more than a settled arm creeps


@dataclass
class KeptTarget:
    """A target. ``X_CO`` (4, 4) and ``covariance`` (6, 6) hold while the arm stands at ``X_BT``.

    ``known``: measured there, carried there by odometry, or lost; ``way_m`` how far it was carried since it
    was measured. ``X_BO`` in the base, by the tool's marker, when it was clicked; None where it was not seen.
    """

    id: str
    kind: Kind
    X_CO: Array
    covariance: Array
    diameter_m: float | None
    quality: float
    outline: Array
    frame_id: int
    X_BT: Array
    X_BO: Array | None
    known: Known = "measured"
    way_m: float = 0.0

    @property
    def believed(self) -> KnownTarget:
        """Where it is, for who measures it again."""
        return KnownTarget(self.kind, self.X_CO, self.covariance, self.diameter_m)


class TargetKeeper:
    """All targets by their ids, oldest first, and which of them programs look at (None: the markers)."""

    def __init__(self, settings: TargetSettings) -> None:
        self._settings = settings
        self._all: OrderedDict[str, KeptTarget] = OrderedDict()
        self._made = 0
        self._aimed: str | None = None

    def list(self) -> list[KeptTarget]:
        """All, oldest first."""
        return [*self._all.values()]

    def get(self, target_id: str) -> KeptTarget:
        """One. Raises RequestRefused (``refused.unknown_target``)."""
        if target_id not in self._all:
            known = ", ".join(self._all) or "none"
            raise RequestRefused("refused.unknown_target", f"no target '{target_id}'; known: {known}")
        return self._all[target_id]

    @property
    def aimed(self) -> KeptTarget | None:
        """What programs look at in place of the object's markers."""
        return None if self._aimed is None else self._all[self._aimed]

    def aim(self, target_id: str) -> None:
        """Have programs look at a target, or at the ``MARKERS``, from now on. Raises as ``get``."""
        self.refuse_unknown(target_id)
        self._aimed = None if target_id == MARKERS else target_id

    def refuse_unknown(self, target_id: str) -> None:
        """Raises as ``get`` for what is neither a target nor the ``MARKERS``."""
        if target_id != MARKERS:
            self.get(target_id)

    def add(self, seen: TargetObservation, frame_id: int, X_BT: Array, X_BO: Array | None) -> KeptTarget:
        """Keep a new one and aim at it; the oldest goes where there would be too many."""
        self._made += 1
        target = KeptTarget(
            f"t{self._made}", seen.kind, seen.X_CO, seen.covariance, seen.diameter_m, seen.quality,
            seen.outline, frame_id, X_BT, X_BO,
        )  # fmt: skip
        self._all[target.id] = target
        self._aimed = target.id
        while len(self._all) > _MOST:
            self._all.popitem(last=False)
        return target

    def remove(self, target_id: str) -> None:
        """Forget one. Raises as ``get``."""
        self.get(target_id)
        del self._all[target_id]
        if self._aimed == target_id:
            self._aimed = None

    def looked(self, X_CO: Array, covariance: Array, X_BT: Array, measured: bool) -> None:
        """Note what a look saw of the target that is aimed at."""
        target = self.aimed
        if target is None:
            return
        target.X_CO, target.covariance, target.X_BT = X_CO, covariance, X_BT
        if measured:
            target.known, target.way_m = "measured", 0.0

    def carry(self, X_C0C: Array | None, X_BT_before: Array, X_BT: Array) -> None:
        """The camera went from C0, where the arm stood at ``X_BT_before``, to C; None: nobody knows where.

        An arm that stands where it stood has lost nothing.
        """
        gone = _apart(X_BT_before, X_BT)
        for target in self._all.values():
            if _apart(target.X_BT, X_BT_before) or (X_C0C is None and gone):
                target.known = "lost"
                continue
            if X_C0C is None:  # such as a motion that was refused
                continue
            if target.known == "lost":
                continue
            X_CC0 = se3.inverse(X_C0C)
            way = float(np.linalg.norm(X_C0C[:3, 3]))
            turn = np.zeros((6, 6))
            turn[:3, :3] = turn[3:, 3:] = X_CC0[:3, :3]
            std = _CARRIED_STD_M + _CARRIED_STD * way
            reach = float(np.linalg.norm(target.X_CO[:3, 3]))
            more = np.diag([std**2] * 3 + [(std / max(reach, 0.3)) ** 2] * 3)
            target.X_CO = X_CC0 @ target.X_CO
            target.covariance = turn @ target.covariance @ turn.T + more
            target.X_BT, target.known, target.way_m = X_BT, "carried", target.way_m + way

    def known_at(self, target: KeptTarget, X_BT: Array) -> Known:
        """How its place is known while the arm stands at ``X_BT``, where nobody has watched it go."""
        return "lost" if _apart(target.X_BT, X_BT) else target.known

    def lose(self) -> None:
        """Nobody knows any more where they are."""
        for target in self._all.values():
            target.known = "lost"

    def refuse_lost(self, X_BT: Array) -> None:
        """Raises RequestRefused (``refused.target_lost``) when the aimed target's place is not known here."""
        target = self.aimed
        if target is not None and self.known_at(target, X_BT) == "lost":
            raise RequestRefused(
                "refused.target_lost", f"target {target.id}: the arm went unwatched; click it again"
            )


def _apart(X_A: Array, X_B: Array) -> bool:
    moved = se3.local(X_A, X_B)
    return bool(np.linalg.norm(moved[:3]) > _STILL or np.linalg.norm(moved[3:]) > _STILL)
