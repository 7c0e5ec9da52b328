"""A click in the right picture: the eyes exchanged, so that the right one is measured in as the left."""

import numpy as np

from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.targets.sighting import Sighted
from vision_pc.core.targets.target import TargetObservation, frame_on
from vision_pc.core.types import CameraCalibration


def exchanged(sighted: Sighted) -> Sighted:
    """The same with left and right exchanged; poses are then in the right eye's frame R."""
    camera = sighted.camera
    X_CR = camera.right.X_CE
    turned = camera._replace(
        left=camera.right._replace(X_CE=se3.identity()),
        right=camera.left._replace(X_CE=se3.inverse(X_CR)),
    )
    offset = sighted.observation.offset
    if offset is not None:
        believed = sighted.believed
        turned = turned._replace(
            left=believed.right._replace(X_CE=se3.identity()),
            right=believed.left._replace(X_CE=se3.inverse(believed.right.X_CE)),
        )
    pair = sighted.pair._replace(left=sighted.pair.right, right=sighted.pair.left)
    X_CM = sighted.observation.X_CM
    told = sighted.observation._replace(
        X_CM=None if X_CM is None else se3.inverse(X_CR) @ X_CM,
        errors=None,
        offset=offset and offset._replace(x_px=0.0, y_px=0.0),
    )
    return sighted._replace(pair=pair, camera=turned, observation=told)


def told_in_left(seen: TargetObservation, camera: CameraCalibration) -> TargetObservation:
    """What was measured with the eyes ``exchanged`` (in R), in C."""
    X_CR = camera.right.X_CE
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = X_CR[:3, :3]
    p = se3.apply(X_CR, seen.X_CO[None, :3, 3])[0]
    X = frame_on(p, X_CR[:3, :3] @ seen.X_CO[:3, 2])
    moved = intrinsics.project(camera.left, p[None])[0] - seen.outline.mean(axis=0)
    return seen._replace(
        X_CO=X,
        covariance=turn @ seen.covariance @ turn.T,
        bias=turn @ seen.bias @ turn.T,
        outline=seen.outline + moved,
    )
