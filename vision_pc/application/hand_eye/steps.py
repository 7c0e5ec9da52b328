"""What the steps of a guided session return: the check at its start, arrivals, samples, the solution."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Method
from vision_pc.core import se3
from vision_pc.core.hand_eye.guided import sampling as guided_sampling
from vision_pc.core.hand_eye.guided import solution as guided_solution
from vision_pc.core.hand_eye.guided.cabinet import Located
from vision_pc.core.hand_eye.guided.sampling import Belief, Proposal
from vision_pc.core.hand_eye.guided.session import Sample, Session
from vision_pc.core.hand_eye.guided.solution import GuidedSolution
from vision_pc.core.hand_eye.guided.target import TargetLook
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import bundle, methods
from vision_pc.core.hand_eye.solvers.bundle import RobotNoise
from vision_pc.core.hand_eye.solvers.result import HandEyeResult
from vision_pc.core.ports import ArmView
from vision_pc.core.se3 import Array

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
