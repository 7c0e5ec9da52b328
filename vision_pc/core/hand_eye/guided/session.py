"""A guided session as data: samples taken, what was refused; to and from its JSON form."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from nominal_arm.dimensions import DhLink
from protocol.errors import RequestRefused
from vision_pc.config.choices import Setup
from vision_pc.config.hand_eye import JOINTS, GuidedSettings
from vision_pc.core.hand_eye.guided.nominal_model import Links
from vision_pc.core.hand_eye.guided.sampling import Proposal
from vision_pc.core.hand_eye.guided.views import Surroundings
from vision_pc.core.hand_eye.samples import CornerViews, PosePairs, pose_pairs
from vision_pc.core.perception.markers import corner_points
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration

FORMAT = "longreach-hand-eye-session/3"
JSON = dict[str, Any]


class Sample(NamedTuple):
    """One sample: the tool X_BT by the controller's model, the pattern X_CP with covariance (6, 6).

    ``corners_left`` (4, 2) px in the left picture; ``marker_id``; ``settled`` by the controller's flag (else
    the encoders alone said so); ``moved_mrad`` by the encoders while it was taken. ``q`` (6,) rad: the joints
    by the encoders.
    """

    name: str
    X_BT: Array
    X_CP: Array
    covariance: Array
    corners_left: Array
    marker_id: int
    settled: bool
    moved_mrad: float
    q: Array


@dataclass(frozen=True, eq=False)
class Session:
    """A session at one instant; every change makes a new one.

    ``seed`` of the proposals; ``proposed`` how many were made; ``refused`` poses X_BT that the controller
    refused. ``links``: the arm's nominal model when the session began.
    """

    name: str
    seed: int
    settings: GuidedSettings
    around: Surroundings
    links: Links
    samples: tuple[Sample, ...] = ()
    proposed: int = 0
    numbered: int = 0
    refused: tuple[Array, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether as many samples as wanted are there."""
        return len(self.samples) >= self.settings.poses

    def without(self, name: str) -> "Session":
        """The session without a sample. Raises RequestRefused (``refused.hand_eye.unknown_sample``)."""
        names = [sample.name for sample in self.samples]
        if name not in names:
            known = ", ".join(names) or "none"
            raise RequestRefused("refused.hand_eye.unknown_sample", f"no sample '{name}'; there are: {known}")
        return replace(self, samples=tuple(s for s in self.samples if s.name != name))

    def with_sample(self, sample: Sample) -> "Session":
        """The session with one more sample, under the next number: none is used twice.

        Raises RequestRefused (``refused.hand_eye.…``) when the sample cannot be believed beside the others.
        """
        number = self.numbered + 1
        samples = (*self.samples, sample._replace(name=str(number)))
        changed = replace(self, samples=samples, numbered=number)
        changed.pairs()
        return changed

    def pairs(self) -> PosePairs:
        """The samples as a solver takes them, with corners of the left eye."""
        camera = self.around.camera
        corners = CornerViews(
            corner_points(self.settings.marker_size_m),
            np.stack([s.corners_left for s in self.samples]),
            camera.left.K,
            camera.left.distortion,
        )
        return pose_pairs(
            np.stack([s.X_BT for s in self.samples]),
            np.stack([s.X_CP for s in self.samples]),
            Setup.EYE_IN_HAND,
            tuple(s.name for s in self.samples),
            corners,
        )


def to_json(session: Session) -> JSON:
    """The session's file: plain numbers, metres, radians and pixels; poses as rows of 4×4."""
    around = session.around
    return {
        "format": FORMAT,
        "name": session.name,
        "seed": session.seed,
        "proposed": session.proposed,
        "numbered": session.numbered,
        "settings": session.settings.model_dump(mode="json"),
        "arm": {"links": [link._asdict() for link in session.links]},
        "camera": {"K": around.camera.left.K.tolist(), "distortion": around.camera.left.distortion.tolist()},
        "start": {
            "X_BT": around.X_BT_start.tolist(),
            "hidden_px": [[list(r) for r in eye] for eye in around.hidden],
            "tool_in_camera_m": around.tool_C.tolist(),
        },
        "samples": [_sample_json(s) for s in session.samples],
        "refused": [{"X_BT": X.tolist()} for X in session.refused],
    }


def _sample_json(s: Sample) -> JSON:
    return {
        "name": s.name,
        "hand": s.X_BT.tolist(),
        "camera": s.X_CP.tolist(),
        "covariance_p_theta": s.covariance.tolist(),
        "corners_px": s.corners_left.tolist(),
        "marker_id": s.marker_id,
        "settled": s.settled,
        "moved_mrad": s.moved_mrad,
        "joints_rad": s.q.tolist(),
    }


def proposal_json(p: Proposal) -> JSON:
    """A proposal's figures."""
    return {
        "X_BT": p.X_BT.tolist(),
        "X_CP": p.X_CP.tolist(),
        "pixel": [round(float(v), 1) for v in p.pixel],
        "distance_m": round(p.distance, 4),
        "obliquity_deg": round(math.degrees(p.obliquity), 2),
        "gain_nats": p.gain,
        "std_after_mm": 1e3 * p.std[0],
        "std_after_deg": math.degrees(p.std[1]),
        "choices": p.choices,
    }


def from_json(document: Mapping[str, Any], camera: CameraCalibration) -> Session:
    """The session of a file, seen with ``camera``.

    Raises RequestRefused: ``refused.hand_eye.format`` naming the key that is missing or wrong, and what
    ``pose_pairs`` refuses, naming the sample.
    """
    if document.get("format") != FORMAT:
        raise RequestRefused(
            "refused.hand_eye.format", f"format is {document.get('format')!r}, {FORMAT!r} is wanted"
        )
    try:
        session = _session_from(document, camera)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        what = f"key {error}" if isinstance(error, KeyError) else " ".join(str(error).split())
        raise RequestRefused(
            "refused.hand_eye.format", f"session file: {what} is missing or wrong"
        ) from error
    for s in session.samples:
        if s.marker_id != session.settings.marker_id:
            raise RequestRefused(
                "refused.hand_eye.marker_id",
                f"sample {s.name}: marker {s.marker_id}, but {session.settings.marker_id} is asked for",
            )
    if session.samples:
        session.pairs()
    return session


def _session_from(document: Mapping[str, Any], camera: CameraCalibration) -> Session:
    start = document["start"]
    hidden = tuple(tuple(_rectangle(r) for r in eye) for eye in start["hidden_px"])
    samples = tuple(
        Sample(
            str(s["name"]),
            _matrix(s["hand"], (4, 4)),
            _matrix(s["camera"], (4, 4)),
            _matrix(s["covariance_p_theta"], (6, 6)),
            _matrix(s["corners_px"], (4, 2)),
            int(s["marker_id"]),
            bool(s["settled"]),
            float(s["moved_mrad"]),
            _matrix(s["joints_rad"], (JOINTS,)),
        )
        for s in document["samples"]
    )
    names = [s.name for s in samples]
    if len(set(names)) != len(names):
        raise ValueError(f"sample names {names}: a name given twice")
    links = tuple(
        DhLink(*(float(_matrix(v[key], ())) for key in DhLink._fields)) for v in document["arm"]["links"]
    )
    if len(links) < JOINTS:
        raise ValueError(f"arm of {len(links)} links")
    if len(hidden) != 2:
        raise ValueError(f"hidden_px of {len(hidden)} eyes")
    return Session(
        name=str(document["name"]),
        seed=int(document["seed"]),
        settings=GuidedSettings.model_validate(document["settings"]),
        around=Surroundings(
            camera, _matrix(start["X_BT"], (4, 4)), hidden, _matrix(start["tool_in_camera_m"], (3,))
        ),
        links=links,
        samples=samples,
        proposed=int(document["proposed"]),
        numbered=int(document["numbered"]),
        refused=tuple(_matrix(r["X_BT"], (4, 4)) for r in document["refused"]),
    )


def _matrix(rows: Any, shape: tuple[int, ...]) -> Array:
    value = np.array(rows, dtype=np.float64)
    if value.shape != shape or not np.isfinite(value).all():
        raise ValueError(f"finite numbers of shape {shape} are wanted, got shape {value.shape}")
    return value


def _rectangle(values: Any) -> tuple[float, float, float, float]:
    a, b, c, d = (float(v) for v in values)
    return a, b, c, d
