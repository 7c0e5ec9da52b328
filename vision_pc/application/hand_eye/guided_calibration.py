"""The guided hand-eye session: check, propose, go, sample, and solve, over the arm and its camera.

Each step that changes the session writes it to the disk before it answers. A step that fails changes nothing
but the list of refused poses.
"""

from dataclasses import replace

import numpy as np

from nominal_arm.dimensions import Dimensions
from protocol.errors import MeasurementFailed, RequestRefused
from vision_pc.application.hand_eye.responses import check_json, sample_json
from vision_pc.application.hand_eye.sensing import (
    HandEyeSight,
    Pictures,
    States,
    back_to_start,
    ended_in_fault,
    impossible,
)
from vision_pc.application.hand_eye.steps import (
    HandArrival,
    NextPose,
    SessionStore,
    SolvedSession,
    StartCheck,
    TakenSample,
    Targets,
    believed,
    checked,
    solved,
    verdict_of,
)
from vision_pc.application.ports import Log, StoppableArm
from vision_pc.config.hand_eye import GuidedSettings
from vision_pc.config.vision import VisionConfig
from vision_pc.core.hand_eye.guided import sampling as guided_sampling
from vision_pc.core.hand_eye.guided import views as guided_views
from vision_pc.core.hand_eye.guided.sampling import Proposal
from vision_pc.core.hand_eye.guided.session import Sample, Session
from vision_pc.core.hand_eye.guided.target import TargetLook
from vision_pc.core.ports import ArmView, Report
from vision_pc.core.se3 import Array

_PATIENCE = 60  # refused proposals in a row before ``next_pose`` gives up
_STUCK = 6  # and before it goes back to the start


class GuidedCalibration:
    """One session at a time, over one rig."""

    def __init__(
        self,
        arm: StoppableArm,
        pictures: Pictures,
        states: States,
        config: VisionConfig,
        nominal: Dimensions,
        log: Log,
        store: SessionStore,
    ) -> None:
        self._arm = arm
        self._pictures = pictures
        self._config = config
        self._nominal = nominal
        self._sight = HandEyeSight(arm, pictures, states, config)
        self._log = log
        self.store = store
        self.defaults = config.hand_eye
        self._session: Session | None = None
        self.X_TC: Array | None = None

    @property
    def session(self) -> Session:
        """The session that is open. Raises RequestRefused (``refused.hand_eye.no_session``)."""
        if self._session is None:
            raise RequestRefused("refused.hand_eye.no_session", "no session is open: start or resume one")
        return self._session

    async def start(self, name: str, settings: GuidedSettings, seed: int, report: Report) -> StartCheck:
        """Checks the starting pose and opens a session there, with no sample yet.

        Raises RequestRefused (``refused.hand_eye.session_exists``), MeasurementFailed when the marker is not
        seen, stands too obliquely, or leaves too few poses to go to.
        """
        if self.store.path(name).exists():
            raise RequestRefused(
                "refused.hand_eye.session_exists",
                f"session '{name}' is on the disk: resume it, or take another",
            )
        report(0.1, "looking at the marker")
        seen, view, _ = await self._sight.marker(settings)
        report(0.6, "looking for poses")
        around = guided_views.surroundings(
            self._sight.camera, view.X_BT, seen.X_CM, self._config.markers.tool.carried_m, settings
        )
        links, boom = self._nominal
        session = Session(name, seed, settings, around, links, boom.wrist_to_tool)
        check = await self._pictures.aside(lambda: checked(session, view.X_BT, seen))
        self._open(session)
        self.X_TC = None
        self._log.write("hand_eye_started", session=name, **check_json(check))
        return check

    def resume(self, name: str) -> Session:
        """Opens a session from the disk."""
        self._session = self.store.load(name, self._sight.camera)
        self._sight.forget()
        self.X_TC = None
        self._log.write("hand_eye_resumed", session=name, samples=len(self._session.samples))
        return self._session

    async def propose(self, informative: bool = True) -> Proposal:
        """The next pose: the most informative one, or any that passes the bounds."""
        session = self.session
        if not session.samples:
            raise RequestRefused("refused.hand_eye.no_sample", "take a sample at the starting pose first")
        proposal = await self._pictures.aside(lambda: self._proposal(session, informative))
        now = self.session  # it may have lost a sample meanwhile
        self._open(replace(now, proposal=proposal, proposed=now.proposed + 1))
        return proposal

    def _proposal(self, session: Session, informative: bool) -> Proposal:
        rng = np.random.default_rng([session.seed, 2, session.proposed])
        belief = believed(session)
        return guided_sampling.propose(
            belief, session.around, session.settings, rng, session.refused, informative
        )

    async def go(self, report: Report) -> HandArrival:
        """Drives to the proposed pose. One that the controller refuses is remembered, and the arm rests."""
        proposal = self.session.proposal
        if proposal is None:
            raise RequestRefused("refused.hand_eye.no_proposal", "no pose is proposed: propose one first")
        report(0.1, "moving")
        view = await self._drive_to(proposal.X_BT, learn=True)
        return HandArrival(view, proposal.X_BT)

    async def sample(self, report: Report, name: str | None = None) -> TakenSample:
        """Takes a sample where the arm stands, in the place of sample ``name`` if that is given."""
        session = self.session
        if name is not None:
            session.sample(name)
        elif session.complete:
            raise RequestRefused(
                "refused.hand_eye.complete",
                f"{len(session.samples)}/{session.settings.poses} samples are taken: solve, or remove one",
            )
        report(0.2, "looking at the marker")
        seen, view, moved = await self._sight.marker(session.settings)
        session = self.session
        if name is None:
            session, name = session.next_name()
        sample = _sample_of(name, seen, view, session.settings, moved)
        self._open(session.with_sample(sample))
        session = self.session
        belief = await self._pictures.aside(lambda: believed(session))
        taken = TakenSample(name, session, seen, moved, belief)
        self._log.write("hand_eye_sample", session=session.name, **sample_json(taken))
        return taken

    async def redo(self, name: str, report: Report) -> TakenSample:
        """Drives back to a sample's pose and takes it again; the old one stays until the new one is there."""
        old = self.session.sample(name)
        report(0.1, f"moving back to sample {name}")
        await self._drive_to(old.X_BT, learn=False)
        return await self.sample(report, name)

    def remove(self, name: str) -> Session:
        """Leaves out a sample for good."""
        self._open(self.session.without(name))
        self._log.write("hand_eye_removed", session=self.session.name, sample=name)
        return self.session

    async def next_pose(self, report: Report, informative: bool = True) -> NextPose:
        """Proposes and drives until the controller accepts a pose; stuck in a corner, from the start again.

        Raises RequestRefused with what the controller said last. After a fault the arm rests, and nothing
        more is tried.
        """
        for count in range(1, _PATIENCE + 1):
            proposal = await self.propose(informative)
            try:
                return NextPose(proposal, await self.go(report))
            except RequestRefused as error:
                if count == _PATIENCE or ended_in_fault(error) or not impossible(error):
                    raise
            if count % _STUCK == 0:
                report(0.1, "moving back to the start")
                await back_to_start(self._arm, self.session)
        raise AssertionError("unreachable")

    async def back(self, report: Report) -> HandArrival:
        """Drives to the session's starting pose, over its samples where the straight way is refused."""
        report(0.1, "moving back to the start")
        view = await back_to_start(self._arm, self.session)
        return HandArrival(view, self.session.around.X_BT_start)

    async def solve(self) -> SolvedSession:
        """X by the certified robust solver with all that is known about it, others beside it, a verdict."""
        session = self.session
        if not session.samples:
            raise MeasurementFailed(
                "measurement.hand_eye.too_few_samples", "0 samples are too few: take some"
            )
        answer = await self._pictures.aside(lambda: solved(session))
        self.X_TC = answer.solution.result.X
        self._log.write("hand_eye_solved", session=session.name, verdict=verdict_of(answer.solution).text)
        return answer

    async def locate(self, report: Report) -> Targets:
        """The cabinet's targets in the hand and in the base, seen from here, with the X solved last.

        Raises RequestRefused (``refused.hand_eye.not_solved``, ``.no_drawing``), MeasurementFailed as
        ``CabinetLocator.locate``.
        """
        if self.X_TC is None:
            raise RequestRefused("refused.hand_eye.not_solved", "no X yet: solve first")
        report(0.2, "looking at the cabinet")
        X_BT, places = await self._sight.cabinet(self.defaults)
        return Targets(X_BT, self.X_TC, places)

    async def _drive_to(self, X_BT: Array, learn: bool) -> ArmView:
        session = self.session
        try:
            return await self._arm.move_to(X_BT)
        except RequestRefused as error:
            if learn and impossible(error):
                self._open(replace(session, proposal=None, refused=(*session.refused, (X_BT, str(error)))))
            raise

    def _open(self, session: Session) -> None:
        self.store.save(session)
        self._session = session


def _sample_of(name: str, seen: TargetLook, view: ArmView, settings: GuidedSettings, moved: float) -> Sample:
    return Sample(
        name, view.X_BT, seen.X_CP, seen.covariance, seen.corners_left, settings.marker_id, view.settled,
        moved, view.q_meas,
    )  # fmt: skip
