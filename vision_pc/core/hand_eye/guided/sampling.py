"""Where to put the hand for the next sample: the pose that tells most about X among those that can be seen.

Each candidate is a view of the marker. What it would add is the Fisher information of the maximum-likelihood
problem H X P = Z with the residual in the camera (``maximum_likelihood``), camera noise as a small marker has
it (range and tilt worse than the rest), and robot noise. Chosen is the candidate that makes the information
about X alone, Z unknown, greatest: the largest determinant (D-optimal design).

Which views there are, and which of them keep the bounds: ``guided_views``.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.hand_eye import GuidedSettings
from vision_pc.core import se3
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.guided.views import (
    Surroundings,
    beside_refused,
    keep_bounds,
    nominal_mount,
    obliquity,
    random_views,
)
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array

_MOUNT_STD_M, _MOUNT_STD_RAD = 0.02, math.radians(6.0)  # [E] of a tape measure, a component
_ROBOT_STD_M, _ROBOT_STD_RAD = 0.001, math.radians(0.1)  # [E] by play and bending, between neighbouring poses
_ROBOT_STRAIN = 0.006  # [M] a metre away: local error of the rigid model
_ROBOT_TWIST = 0.004  # [E] a radian away: encoder zeros within 5 mrad act differently in distant poses
_CORNER_STD_PX = 0.05  # [M] with what lens and rectification leave
_ROUNDS = 20
_DOUBT = 16.8  # χ² with six degrees of freedom beyond which (1 %) a sample counts less in planning
_LOOSE = 1e-6  # information that keeps Z invertible before the first sample


class Belief(NamedTuple):
    """What is believed while planning: X and Z (4, 4), and the information (12, 12) of their perturbation."""

    X: Array
    Z: Array
    information: Array

    @property
    def std(self) -> tuple[float, float]:
        """Standard deviation of X, root of the summed variances: metres, radians."""
        variances = np.diag(np.linalg.inv(self.information))[:6]
        return float(np.sqrt(variances[:3].sum())), float(np.sqrt(variances[3:].sum()))


class Proposal(NamedTuple):
    """The next pose: X_BT, the pattern X_CP as the camera will see it there, and what it is worth.

    ``pixel`` (2,) of the marker's middle in the left picture; ``distance`` m, ``obliquity`` rad; ``gain`` in
    nats of information about X; ``std`` of X afterwards (m, rad), by the planning noise; ``choices``
    candidates passed all bounds.
    """

    X_BT: Array
    X_CP: Array
    pixel: Array
    distance: float
    obliquity: float
    gain: float
    std: tuple[float, float]
    choices: int


def believed(pairs: PosePairs, around: Surroundings, settings: GuidedSettings) -> Belief:
    """X and Z most probable after ``pairs`` (one at least) and the tape measure, with their information.

    Samples that disagree count less (Cauchy), so that one bad sample does not send the hand astray.
    """
    prior = nominal_mount(settings)
    precision = np.zeros((12, 12))
    precision[:6, :6] = np.diag([_MOUNT_STD_M**-2.0] * 3 + [_MOUNT_STD_RAD**-2.0] * 3)
    X, Z = prior, pairs.H[0] @ prior @ pairs.P[0]
    weights = np.ones(len(pairs))
    for _ in range(_ROUNDS):
        V = _covariances(pairs.H, pairs.P, X, Z, around, settings)
        r = ml.residuals(pairs.H, pairs.P, X, Z)
        J = ml.jacobian(Equations(pairs.H, pairs.P, weights), X, Z, r)
        W = weights[:, None, None] * np.linalg.inv(V)
        away = np.concatenate([se3.local(prior, X), np.zeros(6)])
        information = np.einsum("nki,nkl,nlj->ij", J, W, J) + precision
        gradient = np.einsum("nki,nkl,nl->i", J, W, r) + precision @ away
        step = np.linalg.solve(information + _LOOSE * np.eye(12), gradient)
        X, Z = ml.moved(X, Z, -step)
        squares = np.einsum("ni,nij,nj->n", r, np.linalg.inv(V), r)
        weights = 1.0 / (1.0 + np.maximum(squares - _DOUBT, 0.0) / _DOUBT)
        if float(step @ information @ step) < 1e-12:
            break
    return Belief(X, Z, information)


def propose(
    belief: Belief,
    around: Surroundings,
    settings: GuidedSettings,
    rng: np.random.Generator,
    refused: Sequence[Array] = (),
    informative: bool = True,
) -> Proposal:
    """The best of ``settings.candidates`` random views, or with ``informative`` false any one that passes.

    ``refused``: poses X_BT that the controller has refused. Raises MeasurementFailed
    (``measurement.hand_eye.no_pose``) when no candidate passes the bounds.
    """
    X_CP = random_views(settings, around.camera, rng)
    X_BT = belief.Z @ stacks.inverse(X_CP) @ stacks.inverse(belief.X)
    passes = keep_bounds(X_BT, X_CP, around, settings)
    passes &= ~beside_refused(X_BT, refused)
    choices = np.flatnonzero(passes)
    if not len(choices):
        raise MeasurementFailed(
            "measurement.hand_eye.no_pose",
            f"none of {settings.candidates} views of the marker keeps all bounds ({len(refused)} poses were "
            "refused by the controller); begin elsewhere or widen turn_deg, reach_m, distance_m",
        )
    X_CP, X_BT = X_CP[choices], X_BT[choices]
    added = _information(X_BT, X_CP, belief, around, settings)
    values = _about_X(belief.information + added)
    best = int(np.argmax(values)) if informative else 0
    after = belief._replace(information=belief.information + added[best])
    return Proposal(
        X_BT[best],
        X_CP[best],
        intrinsics.project(around.camera.left, X_CP[best, None, :3, 3])[0],
        float(np.linalg.norm(X_CP[best, :3, 3])),
        float(obliquity(X_CP[best : best + 1])[0]),
        float(values[best] - _about_X(belief.information[None])[0]),
        after.std,
        len(choices),
    )


def _information(
    X_BT: Array, X_CP: Array, belief: Belief, around: Surroundings, settings: GuidedSettings
) -> Array:
    """What each sample would add to the information about X and Z, (n, 12, 12)."""
    equations = Equations(X_BT, X_CP, np.ones(len(X_BT)))
    J = ml.jacobian(equations, belief.X, belief.Z, np.zeros((len(X_BT), 6)))
    V = _covariances(X_BT, X_CP, belief.X, belief.Z, around, settings)
    return np.asarray(np.swapaxes(J, -1, -2) @ np.linalg.solve(V, J))


def _covariances(
    X_BT: Array, X_CP: Array, X: Array, Z: Array, around: Surroundings, settings: GuidedSettings
) -> Array:
    """Covariance (n, 6, 6) of each residual: robot noise, and what a small square gives at its distance.

    The robot's share grows with the turn and the way from the starting pose: encoder zeros and bending are
    alike in neighbouring poses, and differ in distant ones. Of the camera's noise a corner's acts as it is
    across the line of sight and about it; along it, and as a tilt, magnified by the distance over the stereo
    baseline.
    """
    start, camera = around.X_BT_start, around.camera
    turn = stacks.angle(np.swapaxes(X_BT[:, :3, :3], -1, -2) @ start[:3, :3])
    way = np.linalg.norm(X_BT[:, :3, 3] - start[:3, 3], axis=1)
    shift = _ROBOT_STD_M**2 + (_ROBOT_STRAIN * way) ** 2
    twist = _ROBOT_STD_RAD**2 + (_ROBOT_TWIST * turn) ** 2
    L = ml.robot_levers(Equations(X_BT, X_CP, np.ones(len(X_BT))), X, Z)
    V = (L * np.stack([shift] * 3 + [twist] * 3, axis=1)[:, None, :]) @ np.swapaxes(L, -1, -2)
    z = np.linalg.norm(X_CP[:, :3, 3], axis=1)
    across = _CORNER_STD_PX * z / camera.left.K[0, 0]
    along = across * z / float(np.linalg.norm(camera.right.X_CE[:3, 3]))
    side = settings.marker_size_m
    stds = np.stack([across, across, along, along / side, along / side, across / side], axis=1)
    V[:, np.arange(6), np.arange(6)] += stds**2
    return np.asarray(V)


def _about_X(information: Array) -> Array:
    """Log-determinant (n,) of the information about X with Z unknown, for (n, 12, 12)."""
    padded = information + _LOOSE * np.eye(12)
    whole, of_Z = np.linalg.slogdet(padded)[1], np.linalg.slogdet(padded[:, 6:, 6:])[1]
    return np.asarray(whole - of_Z)
