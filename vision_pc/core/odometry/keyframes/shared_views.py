"""Which points several keyframes show, and who of them saw what."""

import numpy as np

from vision_pc.core.odometry.keyframes.bundle_adjustment import Views
from vision_pc.core.odometry.keyframes.keyframe import Indices, Keyframe
from vision_pc.core.se3 import Array


def shared(
    chosen: list[Keyframe], shown: Indices, first: Indices, views_alone: bool
) -> tuple[Indices, Views, Indices, Indices]:
    """The map points (m,) of those ``shown`` that at least two of the ``chosen`` keyframes show, their views,
    and which keyframes (n,) first showed which points (n,). What is known of depths holds those, and so their
    right eyes' views are left out; ``views_alone``: depths are not asked, and none is.

    ``first`` (k,): numbers of the keyframes that first showed each point of the map.
    """
    every = np.concatenate([keyframe.ids for keyframe in chosen])
    ids, counts = np.unique(every[np.isin(every, shown)], return_counts=True)
    ids = ids[counts > 1]
    cameras, numbers, eyes, rays, stds = [], [], [], [], []
    depths: list[tuple[Array, Array]] = []
    for k, keyframe in enumerate(chosen):
        mine = np.isin(keyframe.ids, ids)
        new = (first[keyframe.ids] == keyframe.number) & (not views_alone)
        for eye, seen, there in (
            (0, mine, keyframe.rays),
            (1, mine & keyframe.seen_right & ~new, keyframe.right_rays),  # its depth says that already
        ):
            numbers.append(np.searchsorted(ids, keyframe.ids[seen]))
            cameras.append(np.full(len(numbers[-1]), k))
            eyes.append(np.full(len(numbers[-1]), eye))
            rays.append(there[seen])
            stds.append(keyframe.match_stds[eye, seen])
        own = np.searchsorted(ids, keyframe.ids[mine & new])
        depths.append((np.full(len(own), k), own))
    views = Views(
        np.concatenate(cameras),
        np.concatenate(numbers),
        np.concatenate(eyes),
        np.concatenate(rays),
        np.concatenate(stds),
    )
    camera, point = (np.concatenate(part) for part in zip(*depths, strict=True))
    return ids, views, camera, point
