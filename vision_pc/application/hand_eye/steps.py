"""What the steps of a guided session return: the check at its start, arrivals, samples, the solution."""

import json
import math
import os
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from protocol.errors import ConfigurationError, LongreachError, MeasurementFailed, RequestRefused
from vision_pc.config.choices import Method
from vision_pc.config.hand_eye import CabinetSettings
from vision_pc.core import se3
from vision_pc.core.hand_eye.guided import sampling as guided_sampling
from vision_pc.core.hand_eye.guided import solution as guided_solution
from vision_pc.core.hand_eye.guided.cabinet import Drawing, Located, Target
from vision_pc.core.hand_eye.guided.sampling import Belief, Proposal
from vision_pc.core.hand_eye.guided.session import Sample, Session, from_json, to_json
from vision_pc.core.hand_eye.guided.solution import GuidedSolution
from vision_pc.core.hand_eye.guided.target import TargetLook
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import bundle, methods
from vision_pc.core.hand_eye.solvers.bundle import RobotNoise
from vision_pc.core.hand_eye.solvers.result import HandEyeResult
from vision_pc.core.ports import ArmView
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration

_OWN = frozenset({".json", ".part"})
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


class SessionStore:
    """The sessions in one directory."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory

    def refuse_strangers(self) -> None:
        """Raises ConfigurationError when the directory holds anything but sessions: it is somebody else's."""
        try:
            others = [path.name for path in self.directory.iterdir() if path.suffix not in _OWN]
        except FileNotFoundError:
            return  # it is made with the first session
        except OSError as error:
            why = f"sessions_dir = {self.directory}: {error.strerror}"
            raise ConfigurationError("configuration.sessions_dir_unreadable", why) from error
        if others:
            why = f"sessions_dir = {self.directory}: holds what is no session: {min(others)}"
            raise ConfigurationError("configuration.sessions_dir_not_ours", why)

    def names(self) -> list[str]:
        """All sessions, sorted."""
        return sorted(path.stem for path in self.directory.glob("*.json"))

    def path(self, name: str) -> Path:
        """A session's file. Raises RequestRefused (``refused.hand_eye.name``) for what is no plain name."""
        if not _NAME.fullmatch(name):
            raise RequestRefused(
                "refused.hand_eye.name",
                f"session name {name!r}: letters, digits, - and _ are wanted, 64 at most",
            )
        return self.directory / f"{name}.json"

    def save(self, session: Session) -> None:
        """Save the session on the disk. Raises LongreachError (``hand_eye.unwritable``)."""
        path = self.path(session.name)
        partial = path.with_suffix(".part")
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            with partial.open("w", encoding="utf-8") as file:
                json.dump(to_json(session), file, indent=1)
                file.write("\n")
                file.flush()
                os.fsync(file.fileno())
            partial.replace(path)
        except OSError as error:
            raise LongreachError("hand_eye.unwritable", f"{path}: {error.strerror}") from error

    def load(self, name: str, camera: CameraCalibration) -> Session:
        """A session from the disk.

        Raises RequestRefused: ``refused.hand_eye.unknown_session``, or what is wrong with its file.
        """
        path = self.path(name)
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            known = ", ".join(self.names()) or "none"
            raise RequestRefused(
                "refused.hand_eye.unknown_session", f"no session '{name}'; there are: {known}"
            ) from None
        except OSError as error:
            raise RequestRefused("refused.hand_eye.format", f"{path}: {error.strerror}") from error
        except ValueError as error:
            raise RequestRefused("refused.hand_eye.format", f"{path.name}: not JSON: {error}") from error
        if not isinstance(document, dict):
            raise RequestRefused("refused.hand_eye.format", f"{path.name}: an object is wanted")
        return from_json(document, camera)


def load_drawing(settings: CabinetSettings | None) -> Drawing:
    """The cabinet's drawing from its file. Raises RequestRefused (``refused.hand_eye.no_drawing``)."""
    if settings is None:
        raise RequestRefused("refused.hand_eye.no_drawing", "no cabinet is configured (vision.cabinet)")
    picture = cv2.imread(str(settings.drawing), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        why = f"cabinet.drawing {settings.drawing}: not a picture that can be read"
        raise RequestRefused("refused.hand_eye.no_drawing", why)
    targets = tuple(Target(name, x, y) for name, (x, y) in settings.targets_m.items())
    return Drawing(np.asarray(picture, dtype=np.uint8), 1e-3 * settings.texel_mm, targets)


COMPARED = (Method.TSAI, Method.HORAUD, Method.DANIILIDIS, Method.DQCR, Method.MAXIMUM_LIKELIHOOD)
WANTED_STD_M = 0.003


class StartCheck(NamedTuple):
    """A look at the marker from the starting pose; ``choices`` poses around it keep all bounds.

    ``promised_std`` (m, rad): how well X is to be known after all samples, by the planning noise.
    """

    session: Session
    seen: TargetLook
    choices: int
    promised_std: tuple[float, float]


class HandArrival(NamedTuple):
    """The arm after a motion to the hand's pose X_BT_ref."""

    view: ArmView
    X_BT_ref: Array


class NextPose(NamedTuple):
    """A proposal that the controller accepted, and the arm there."""

    proposal: Proposal
    arrival: HandArrival


class TakenSample(NamedTuple):
    """A sample by its ``name`` in the ``session`` that has it, the look it rests on, and what is believed."""

    name: str
    session: Session
    seen: TargetLook
    moved_mrad: float
    belief: Belief


class Targets(NamedTuple):
    """The cabinet's targets as seen from X_BT with the camera at X_TC in the hand."""

    X_BT: Array
    X_TC: Array
    targets: Sequence[Located]

    def in_hand(self, target: Located) -> Array:
        """The target in the hand, (3,) m."""
        return se3.apply(self.X_TC, target.p_C[None]).ravel()

    def in_base(self, target: Located) -> Array:
        """The target in the base, (3,) m."""
        return se3.apply(self.X_BT @ self.X_TC, target.p_C[None]).ravel()


class OtherMethod(NamedTuple):
    """What another method makes of the same samples: its X_TC, or why it has none."""

    name: str
    answer: Array | MeasurementFailed


class SolvedSession(NamedTuple):
    """The solution of a session, and others beside it."""

    solution: GuidedSolution
    others: tuple[OtherMethod, ...]


class SolutionVerdict(NamedTuple):
    """Whether X is good enough, and why in one line."""

    good: bool
    text: str


def believed(session: Session) -> Belief:
    """What the session's samples and the tape measure say of X and Z."""
    return guided_sampling.believed(session.pairs(), session.around, session.settings)


def checked(session: Session, X_BT: Array, seen: TargetLook) -> StartCheck:
    """The view of the marker from the starting pose, and what the poses around it promise."""
    settings = session.settings
    here = Sample("start", X_BT, seen.X_CP, seen.covariance, seen.corners_left, settings.marker_id, True, 0.0)
    belief = believed(session.with_sample(here))
    choices = 0
    for number in range(settings.poses - 1):
        proposal = guided_sampling.propose(
            belief, session.around, settings, np.random.default_rng([session.seed, 1, number])
        )
        choices = choices or proposal.choices
        added = guided_sampling.information_of(proposal, belief, session.around, settings)
        belief = belief._replace(information=belief.information + added)
    return StartCheck(session, seen, choices, belief.std)


def solved(session: Session) -> SolvedSession:
    """The solution of a session with covariance, residuals, proof and verdict; others beside it.

    The image-space adjustment takes the hand's poses as the solution has corrected them, others as reported.
    """
    pairs = session.pairs()
    solution = guided_solution.solve(session)
    result = solution.result
    others = [OtherMethod(m.value, _or_failed(partial(_X_by, m, pairs))) for m in COMPARED]
    noise = result.noise
    robot = None
    if noise is not None and min(noise.robot_rotation, noise.robot_translation) > 0.0:
        robot = RobotNoise(noise.robot_rotation, noise.robot_translation)
    adjusted = _or_failed(lambda: bundle.adjust(solution.pairs, result, robot).X)
    return SolvedSession(solution, (*others, OtherMethod("image-space", adjusted)))


def _X_by(method: Method, pairs: PosePairs) -> Array:
    return methods.solve(pairs, method).X


def _or_failed(solve: Callable[[], Array]) -> Array | MeasurementFailed:
    try:
        return solve()
    except MeasurementFailed as error:
        return error


def verdict_of(solution: GuidedSolution) -> SolutionVerdict:
    """The verdict; its uncertainty counts what arm and camera are not known by."""
    result = solution.result
    assert result.certificate is not None
    std = np.sqrt(np.diag(solution.covariance))
    std_m, std_rad = float(np.linalg.norm(std[:3])), float(np.linalg.norm(std[3:]))
    proven = result.certificate.holds
    good = proven and std_m <= WANTED_STD_M
    text = (
        f"{'good' if good else 'take more samples'}: X known to {1e3 * std_m:.2f} mm and "
        f"{math.degrees(std_rad):.3f}°, {'proven global' if proven else 'not proven global'}, "
        f"{len(left_out(result))} of {len(result.names)} samples left out"
    )
    return SolutionVerdict(good, text)


def left_out(result: HandEyeResult) -> list[str]:
    """The names of the samples that the solution does not rest on."""
    return [name for name, inlier in zip(result.names, result.inliers, strict=True) if not inlier]
