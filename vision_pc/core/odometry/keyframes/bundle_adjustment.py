"""Keyframes and their points adjusted together: what neither filter nor single poses can undo.

A frame's pose is found against the map as it stands, and a point's depth from poses as they stand; over a
long way their common errors add up. Here the poses of the newest keyframes and the points that they share
are moved at once until both eyes' views agree best (Triggs et al. 2000): Gauss-Newton with damping, points
eliminated by the Schur complement, Huber weights. What all frames between the keyframes have taught about a
point's depth enters as a view of its own, in the keyframe that first showed it.
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraModel


class Blocks(NamedTuple):
    """Normal equations: poses H (k, 6, 6) b (k, 6), points V (m, 3, 3) c (m, 3), mixed W (k, m, 6, 3)."""

    H: Array
    b: Array
    V: Array
    c: Array
    W: Array


def summation(group: NDArray[np.int64], groups: int) -> scipy.sparse.csr_array:
    """The matrix that sums rows by their ``group`` (n,)."""
    ones, rows = np.ones(len(group)), np.arange(len(group))
    return scipy.sparse.csr_array((ones, (group, rows)), shape=(groups, len(group)))


def summed(summation: scipy.sparse.csr_array, values: Array) -> Array:
    """Blocks ``values`` (n, ...) summed by group (groups, ...)."""
    return np.asarray(summation @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])


def _damped(blocks: Array, damping: float) -> Array:
    """Blocks (n, d, d), their diagonals raised by a share; one where nothing is known: they are solved."""
    eye = np.eye(blocks.shape[1])
    diagonal = np.einsum("nij,ij->nij", blocks, eye)
    return np.asarray(blocks + damping * diagonal + (eye != 0.0) * (diagonal == 0.0))


def step(blocks: Blocks, damping: float) -> tuple[Array, Array]:
    """Moves of the free poses (k, 6) and of the points (m, 3): points eliminated, then put back.

    What no view tells of stays where it is.
    """
    free, count = blocks.W.shape[:2]
    V, H = _damped(blocks.V, damping), _damped(blocks.H, damping)
    eliminated = blocks.W @ np.linalg.inv(V)  # (k, m, 6, 3)
    flat = eliminated.transpose(0, 2, 1, 3).reshape(6 * free, 3 * count)
    mixed = blocks.W.transpose(0, 2, 1, 3).reshape(6 * free, 3 * count)
    S = -flat @ mixed.T
    for k in range(free):
        S[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += H[k]
    poses = np.linalg.solve(S, blocks.b.ravel() - flat @ blocks.c.ravel())
    points = np.linalg.solve(V, (blocks.c.ravel() - mixed.T @ poses).reshape(count, 3, 1))[..., 0]
    return np.asarray(poses.reshape(free, 6)), np.asarray(points)


_ROUNDS = 6
_DAMPING = (1e-6, 1e4)  # first, and the one at which nothing better is thought to be near
_UNDAMPED = 1e-10  # what is solved once and for what it tells: damping would look like knowledge
_LEAST_DEPTH = 1e-2  # m; nothing nearer is in the map
_CONVERGED = 1e-4  # relative fall of the cost


class Views(NamedTuple):
    """Who saw what: ``camera`` (n,) and ``point`` (n,) count within the problem, ``eye`` (n,) 0 left 1 right,
    ``rays`` (n, 2) undistorted. ``stds`` (n,) px: what views are off by beside the usual noise.
    """

    camera: NDArray[np.int64]
    point: NDArray[np.int64]
    eye: NDArray[np.int64]
    rays: Array
    stds: Array


class Depths(NamedTuple):
    """Points whose inverse depth in a camera is known: ``camera`` and ``point`` (n,) as in ``Views``,
    ``inverse`` (n,) and its ``std`` (n,), 1/m.
    """

    camera: NDArray[np.int64]
    point: NDArray[np.int64]
    inverse: Array
    std: Array


class Problem(NamedTuple):
    """``X_CC0`` (k, 4, 4), the first ``fixed`` of which stay; ``points`` (m, 3) in C0."""

    X_CC0: Array
    fixed: int
    points: Array
    views: Views
    depths: Depths


class Adjusted(NamedTuple):
    """Poses (k, 4, 4), points (m, 3), and the cost before and after, in squared standard deviations."""

    X_CC0: Array
    points: Array
    cost_before: float
    cost_after: float


def adjusted(
    problem: Problem, eyes: tuple[CameraModel, CameraModel], noise_px: float, huber_px: float
) -> Adjusted:
    """The problem's poses and points where its cost is least, or as they are where no step lowers it.

    ``noise_px`` of one coordinate of a view; views farther off than ``huber_px`` count less.
    """
    linear = _Linearisation(problem, eyes, noise_px, huber_px)
    X_CC0, points, damping = problem.X_CC0, problem.points, _DAMPING[0]
    cost_before = cost = linear.cost(X_CC0, points)
    for _ in range(_ROUNDS):
        blocks = linear.blocks(X_CC0, points)
        while damping < _DAMPING[1]:
            turned, moved = step(blocks, damping)
            tried = X_CC0.copy()
            for k, twist in enumerate(turned, problem.fixed):
                tried[k] = se3.transform(se3.exp_so3(twist[3:]), twist[:3]) @ X_CC0[k]
            tried_cost = linear.cost(tried, points + moved)
            if tried_cost < cost:
                break
            damping *= 10.0
        else:
            break
        X_CC0, points, fallen = tried, points + moved, cost - tried_cost
        cost, damping = tried_cost, max(0.1 * damping, _DAMPING[0])
        if fallen < _CONVERGED * cost:
            break
    return Adjusted(X_CC0, points, cost_before, cost)


class OffsetTold(NamedTuple):
    """What views tell of one number: their ``information`` of it (1/σ²), and that times what it is."""

    information: float
    score: float


def shared_offset(
    problem: Problem, eyes: tuple[CameraModel, CameraModel], noise_px: float, huber_px: float
) -> OffsetTold:
    """What the views of ``problem``, adjusted already, tell of an offset (px) of all the right eye's columns,
    whatever poses and points are: near and far points that are seen on the way disagree on where it ends.
    """
    linear = _Linearisation(problem, eyes, noise_px, huber_px)
    alone, blocks, missed = linear.with_offset(problem.X_CC0, problem.points)
    taken = step(blocks, _UNDAMPED)
    taken_by = float((blocks.b * taken[0]).sum() + (blocks.c * taken[1]).sum())
    given = linear.blocks(problem.X_CC0, problem.points)
    explained = float((given.b * taken[0]).sum() + (given.c * taken[1]).sum())
    return OffsetTold(max(alone - taken_by, 0.0), missed - explained)


class _Linearisation:
    """Errors of a problem and their linearisation; views come first, depths after, as rows whose second
    half is empty.
    """

    def __init__(
        self, problem: Problem, eyes: tuple[CameraModel, CameraModel], noise_px: float, huber_px: float
    ) -> None:
        views, depths = problem.views, problem.depths
        self._views = views
        self._depths = depths
        free, points = len(problem.X_CC0) - problem.fixed, len(problem.points)
        self._camera = np.concatenate([views.camera, depths.camera])
        self._point = np.concatenate([views.point, depths.point])
        self._moves = np.flatnonzero(self._camera >= problem.fixed)
        camera, point = self._camera[self._moves] - problem.fixed, self._point[self._moves]
        self._of_camera = summation(camera, free)
        self._of_pair = summation(camera * points + point, free * points)
        self._of_point = summation(self._point, points)
        self._noise_px = np.hypot(noise_px, views.stds)
        self._scale = np.array([eye.K[0, 0] for eye in eyes])[views.eye] / self._noise_px
        self._X_EC = np.stack([se3.inverse(eye.X_CE) for eye in eyes])[views.eye]
        self._huber = huber_px / noise_px

    def cost(self, X_CC0: Array, points: Array) -> float:
        """Robust cost of all views and depths."""
        size = np.linalg.norm(self._errors(X_CC0, points)[0], axis=1)
        robust = np.where(size < self._huber, size**2, self._huber * (2.0 * size - self._huber))
        return float(robust.sum())

    def with_offset(self, X_CC0: Array, points: Array) -> tuple[float, Blocks, float]:
        """As if the views missed by an offset of 1 px of the right eye's columns and by nothing else: its own
        square, the normal equations, and its product with what the views truly miss by.
        """
        errors, _, _ = self._errors(X_CC0, points)
        weights = np.minimum(1.0, self._huber / np.maximum(np.linalg.norm(errors, axis=1), 1e-12))
        offset = self.offset()
        blocks = self.blocks(X_CC0, points, offset)
        weighted = weights[:, None] * offset
        return float((weighted * offset).sum()), blocks, float((weighted * errors).sum())

    def offset(self) -> Array:
        """What 1 px of the right eye's columns makes of all errors (n, 2)."""
        found = np.zeros((len(self._camera), 2))
        found[: len(self._views.eye), 0] = self._views.eye / self._noise_px
        return found

    def blocks(self, X_CC0: Array, points: Array, missed: Array | None = None) -> Blocks:
        """The normal equations at ``X_CC0`` and ``points``; a pose moves by [p; θ] in its own camera.
        ``missed`` (n, 2): in place of what the views miss by, which weighs them all the same.
        """
        errors, rate, in_camera = self._errors(X_CC0, points)
        weights = np.minimum(1.0, self._huber / np.maximum(np.linalg.norm(errors, axis=1), 1e-12))
        to_pose = _to_pose(rate, in_camera)
        to_point = rate @ X_CC0[self._camera, :3, :3]

        errors = errors if missed is None else missed
        moves, count = self._moves, len(points)
        by_point = np.swapaxes(weights[:, None, None] * to_point, 1, 2)
        by_pose = np.swapaxes(weights[moves, None, None] * to_pose[moves], 1, 2)
        W = summed(self._of_pair, by_pose @ to_point[moves])
        return Blocks(
            summed(self._of_camera, by_pose @ to_pose[moves]),
            summed(self._of_camera, np.einsum("nij,nj->ni", by_pose, errors[moves])),
            summed(self._of_point, by_point @ to_point),
            summed(self._of_point, np.einsum("nij,nj->ni", by_point, errors)),
            W.reshape(-1, count, 6, 3),
        )

    def _errors(self, X_CC0: Array, points: Array) -> tuple[Array, Array, Array]:
        """Measured minus expected (n, 2) in standard deviations, how fast what is expected changes with the
        point in its camera (n, 2, 3), and that point (n, 3).
        """
        X = X_CC0[self._camera]
        in_camera = np.einsum("nij,nj->ni", X[:, :3, :3], points[self._point]) + X[:, :3, 3]
        count = len(self._views.camera)
        in_eye = np.einsum("nij,nj->ni", self._X_EC[:, :3, :3], in_camera[:count]) + self._X_EC[:, :3, 3]
        errors, rate = np.zeros((len(X), 2)), np.zeros((len(X), 2, 3))
        near = 1.0 / np.maximum(in_eye[:, 2], _LEAST_DEPTH)
        errors[:count] = self._scale[:, None] * (self._views.rays - in_eye[:, :2] * near[:, None])
        rate[:count, 0, 0] = rate[:count, 1, 1] = self._scale * near
        rate[:count, :, 2] = -self._scale[:, None] * in_eye[:, :2] * near[:, None] ** 2
        rate[:count] = rate[:count] @ self._X_EC[:, :3, :3]
        near = 1.0 / np.maximum(in_camera[count:, 2], _LEAST_DEPTH)
        errors[count:, 0] = (self._depths.inverse - near) / self._depths.std
        rate[count:, 0, 2] = -(near**2) / self._depths.std
        return errors, rate, in_camera


def _to_pose(rate: Array, in_camera: Array) -> Array:
    """How errors (n, 2, 6) change with their pose, from how they do with points (n, 3) in its camera."""
    turn = np.cross(in_camera[:, None, :], rate)  # a · (θ × p) = (p × a) · θ
    return np.concatenate([rate, turn], axis=2)
