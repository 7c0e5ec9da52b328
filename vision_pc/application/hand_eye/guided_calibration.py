"""The guided hand-eye session: check, sample, drive to the next pose, and solve, over the arm and its camera.

Each step that changes the session writes it to the disk before it answers. A step that fails changes nothing
but the list of refused poses.
"""

from dataclasses import replace

import numpy as np

from nominal_arm.dimensions import Dimensions
from protocol.errors import MeasurementFailed, RequestRefused
from vision_pc.application.camera_eyes import CameraEyes
from vision_pc.application.hand_eye.responses import (
    arrival_json,
    believed,
    check_json,
    sample_json,
    session_json,
    solved_json,
)
from vision_pc.application.hand_eye.session_store import SessionStore
from vision_pc.application.ports import Log, StoppableArm
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.application.results import JSON
from vision_pc.config.hand_eye import GuidedSettings
from vision_pc.config.vision import VisionConfig
from vision_pc.core.hand_eye.guided import sampling, solution, views
from vision_pc.core.hand_eye.guided.sampling import Proposal
from vision_pc.core.hand_eye.guided.session import Sample, Session, proposal_json
from vision_pc.core.hand_eye.guided.target import TargetLook, look_at_target, target_settings
from vision_pc.core.hand_eye.samples import pose_pairs
from vision_pc.core.perception.intrinsics import calibration
from vision_pc.core.ports import ArmView, Report
from vision_pc.core.types import FrameObservation

_PATIENCE = 60  # refused proposals in a row before ``next_pose`` gives up
_STUCK = 6  # and before it goes back to the start
_MOST_MOVED_MRAD = 1.0  # [D] an encoder that moves by more while a sample is taken spoils it
_IMPOSSIBLE = {
    f"refused.{reason}"
    for reason in (
        "outside_workspace", "joint_limit", "unreachable", "singular", "too_fast", "too_far",
        "fault_joint_limit", "fault_workspace_limit", "fault_following_error",
    )
}  # fmt: skip
"""Causes of a pose that is not to be tried again: it was refused for its path, or that ended in a fault."""


_FAULT = "refused.fault_"
"""How causes begin by which the arm has come to rest, and moves again only after RESET and ENABLE."""


class GuidedCalibration:
    """One session at a time, over one rig."""

    def __init__(
        self,
        arm: StoppableArm,
        eyes: CameraEyes,
        link: ReferenceLink,
        config: VisionConfig,
        nominal: Dimensions,
        log: Log,
        store: SessionStore,
    ) -> None:
        self._arm = arm
        self._eyes = eyes
        self._link = link
        self._config = config
        self._nominal = nominal
        self._log = log
        self.store = store
        self.defaults = config.hand_eye
        self._camera = calibration(config.camera)
        self._last: FrameObservation | None = None
        self._session: Session | None = None

    @property
    def session(self) -> Session:
        """The session that is open. Raises RequestRefused (``refused.hand_eye.no_session``)."""
        if self._session is None:
            raise RequestRefused("refused.hand_eye.no_session", "no session is open: start or resume one")
        return self._session

    async def start(self, name: str, settings: GuidedSettings, seed: int, report: Report) -> JSON:
        """The verdict on the starting pose; a session is open there, with no sample yet.

        Raises RequestRefused (``refused.hand_eye.session_exists``), MeasurementFailed when the marker is not
        seen, stands too obliquely, or leaves too few poses to go to.
        """
        if self.store.path(name).exists():
            raise RequestRefused(
                "refused.hand_eye.session_exists",
                f"session '{name}' is on the disk: resume it, or take another",
            )
        report(0.1, "looking at the marker")
        seen, view, _ = await self._marker(settings)
        report(0.6, "looking for poses")
        carried = self._config.markers.tool.carried_m
        around = views.surroundings(self._camera, view.X_BT, seen.X_CM, carried, settings)
        session = Session(name, seed, settings, around, self._nominal[0])
        alone = pose_pairs(view.X_BT[None], seen.X_CP[None])
        rng = np.random.default_rng([seed, 1, 0])
        proposal = await self._eyes.aside(
            lambda: sampling.propose(sampling.believed(alone, around, settings), around, settings, rng)
        )
        self._open(session)
        check = check_json(session, seen, proposal.choices)
        self._log.write("hand_eye_started", session=name, **check)
        return check | {"session": session_json(session)}

    def resume(self, name: str) -> Session:
        """Opens a session from the disk; the marker is looked for in the whole picture again."""
        self._session = self.store.load(name, self._camera)
        self._last = None
        self._log.write("hand_eye_resumed", session=name, samples=len(self._session.samples))
        return self._session

    async def sample(self, report: Report) -> JSON:
        """Takes a sample where the arm stands."""
        session = self.session
        if session.complete:
            raise RequestRefused(
                "refused.hand_eye.complete",
                f"{len(session.samples)}/{session.settings.poses} samples are taken: solve, or remove one",
            )
        report(0.2, "looking at the marker")
        seen, view, moved = await self._marker(session.settings)
        session = self.session
        sample = Sample(
            "", view.X_BT, seen.X_CP, seen.covariance, seen.corners_left, session.settings.marker_id,
            view.settled, moved, view.q_meas,
        )  # fmt: skip
        session = session.with_sample(sample)
        self._open(session)
        belief = await self._eyes.aside(lambda: believed(session))
        taken = sample_json(session, belief, seen, moved)
        self._log.write("hand_eye_sample", session=session.name, **taken)
        return taken

    def remove(self, name: str) -> Session:
        """Leaves out a sample for good."""
        self._open(self.session.without(name))
        self._log.write("hand_eye_removed", session=self.session.name, sample=name)
        return self.session

    async def next_pose(self, report: Report, informative: bool = True) -> JSON:
        """Drives to the most informative pose, or any in bounds, until the controller accepts one.

        Poses that it refuses are remembered; stuck in a corner, the arm goes back to the start. Raises
        RequestRefused with what the controller said last. After a fault the arm rests, and nothing more is
        tried.
        """
        for count in range(1, _PATIENCE + 1):
            proposal = await self._proposal(informative)
            report(0.1, "moving")
            try:
                return proposal_json(proposal) | arrival_json(
                    await self._arm.move_to(proposal.X_BT), proposal.X_BT
                )
            except RequestRefused as error:
                if error.cause not in _IMPOSSIBLE:
                    raise
                self._open(replace(self.session, refused=(*self.session.refused, proposal.X_BT)))
                if count == _PATIENCE or error.cause.startswith(_FAULT):
                    raise
            if count % _STUCK == 0:
                await self.back(report)
        raise AssertionError("unreachable")

    async def _proposal(self, informative: bool) -> Proposal:
        session = self.session
        if not session.samples:
            raise RequestRefused("refused.hand_eye.no_sample", "take a sample at the starting pose first")
        rng = np.random.default_rng([session.seed, 2, session.proposed])
        bounds = session.around, session.settings, rng, session.refused, informative
        proposal = await self._eyes.aside(lambda: sampling.propose(believed(session), *bounds))
        now = self.session  # it may have lost a sample meanwhile
        self._open(replace(now, proposed=now.proposed + 1))
        return proposal

    async def back(self, report: Report) -> JSON:
        """Drives to the session's starting pose: straight there, or over its samples, the newest first.

        What led to a sample leads back from it, where the straight path would turn the wrist through its
        limits. Raises RequestRefused with what the controller said last.
        """
        report(0.1, "moving back to the start")
        session = self.session
        start = session.around.X_BT_start
        for sample in (None, *reversed(session.samples)):
            try:
                if sample is not None:
                    await self._arm.move_to(sample.X_BT)
                return arrival_json(await self._arm.move_to(start), start)
            except RequestRefused as error:
                if error.cause not in _IMPOSSIBLE or error.cause.startswith(_FAULT):
                    raise
                refusal = error
        raise refusal

    async def solve(self) -> JSON:
        """X by the certified robust solver with all that is known about it."""
        session = self.session
        if not session.samples:
            raise MeasurementFailed(
                "measurement.hand_eye.too_few_samples", "0 samples are too few: take some"
            )
        answer = solved_json(await self._eyes.aside(lambda: solution.solve(session)))
        self._log.write("hand_eye_solved", session=session.name, verdict=answer["verdict"])
        return answer

    def _open(self, session: Session) -> None:
        self.store.save(session)
        self._session = session

    async def _marker(self, settings: GuidedSettings) -> tuple[TargetLook, ArmView, float]:
        """The marker, the arm there, and by how many mrad an encoder moved meanwhile.

        Raises MeasurementFailed (``measurement.hand_eye.not_settled``, and what ``look_at_target`` raises).
        """
        before = await self._settled_view()
        pictures = await self._eyes.pairs_at_rest(settings.frames)
        after = await self._arm.view()
        moved = 1e3 * float(np.abs(after.q_meas - before.q_meas).max())
        if moved > _MOST_MOVED_MRAD or before.motion_id != after.motion_id:
            raise MeasurementFailed(
                "measurement.hand_eye.not_settled",
                f"the arm moved by {moved:.2f} mrad while the sample was taken, "
                f"limit {_MOST_MOVED_MRAD:g} mrad",
            )
        known, expected = target_settings(self._config.markers, settings), self._config.markers.sizes
        camera, look, last = self._camera, self._config.look, self._last
        seen = await self._eyes.aside(
            lambda: look_at_target(pictures.pairs, camera, known, look, settings, last, frozenset(expected))
        )
        self._last = seen.last
        return seen, after._replace(X_BT=pictures.X_BT), moved

    async def _settled_view(self) -> ArmView:
        """The view once the controller's flag says settled, or the time for it has passed."""
        view = await self._arm.view()
        began_ns, timeout_ns = view.time_ns, 1e9 * self._config.motion.settle_timeout_s
        while not view.settled and view.time_ns - began_ns < timeout_ns:
            await self._link.next_state()
            view = await self._arm.view()
        return view
