"""The guided hand-eye session: check, propose, go, sample, and solve, over the arm and its camera.

Each step that changes the session writes it to the disk before it answers. A step that fails changes nothing
but the list of refused poses.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, TypeVar

import numpy as np

from protocol.errors import MeasurementFailed, RequestRefused
from protocol.reference_link import State
from vision_pc.config import VisionConfig
from vision_pc.core import se3
from vision_pc.core.hand_eye import cabinet, guided_sampling, target
from vision_pc.core.hand_eye.cabinet import Drawing, Located
from vision_pc.core.hand_eye.guided_sampling import Belief, Proposal
from vision_pc.core.hand_eye.guided_settings import GuidedSettings
from vision_pc.core.hand_eye.session import Sample, Session, proposal_json
from vision_pc.core.hand_eye.target import TargetLook
from vision_pc.core.intrinsics import calibration, with_offset
from vision_pc.core.look import observe
from vision_pc.core.ports import ArmView, Photographer, Report
from vision_pc.core.se3 import Array
from vision_pc.core.types import FrameObservation, StereoPair
from vision_pc.shell.event_log import EventLog
from vision_pc.shell.hand_eye_answers import marker_json, off, residuals, solved
from vision_pc.shell.hand_eye_store import SessionStore, load_drawing
from vision_pc.shell.schemas import JSON, pose_json
from vision_pc.shell.station import StoppableArm

T = TypeVar("T")

_PATIENCE = 60  # refused proposals in a row before ``next_pose`` gives up


class Pictures(Photographer, Protocol):
    """The camera, and a place to compute that does not hold up the link."""

    async def aside(self, work: Callable[[], T]) -> T: ...


class States(Protocol):
    """The controller's states as they come."""

    async def next_state(self) -> State: ...


class GuidedCalibration:
    """One session at a time, over one rig."""

    def __init__(
        self,
        arm: StoppableArm,
        pictures: Pictures,
        states: States,
        config: VisionConfig,
        log: EventLog,
        store: SessionStore,
    ) -> None:
        self._arm = arm
        self._pictures = pictures
        self._states = states
        self._config = config
        self._camera = calibration(config.camera)
        self._log = log
        self.store = store
        self.defaults = config.hand_eye
        self._session: Session | None = None
        self.X_TC: Array | None = None
        self._last: FrameObservation | None = None
        self._offset: FrameObservation | None = None
        self._loaded: Drawing | None = None

    @property
    def session(self) -> Session:
        """The session that is open. Raises RequestRefused (``refused.hand_eye.no_session``)."""
        if self._session is None:
            raise RequestRefused("refused.hand_eye.no_session", "no session is open: start or resume one")
        return self._session

    async def start(self, name: str, settings: GuidedSettings, seed: int, report: Report) -> JSON:
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
        seen, view, _ = await self._look(settings)
        report(0.6, "looking for poses")
        around = guided_sampling.surroundings(
            self._camera, view.X_BT, seen.X_CM, self._config.markers.tool.carried_m, settings
        )
        session = Session(name, seed, settings, around)
        check = await self._pictures.aside(lambda: self._checked(session, view.X_BT, seen))
        self._open(session)
        self.X_TC = None
        self._log.write("hand_eye_started", session=name, **check)
        return check | {"session": self.view()}

    def _checked(self, session: Session, X_BT: Array, seen: TargetLook) -> JSON:
        """The verdict on the starting pose: the view of the marker, and what the poses around it promise."""
        settings = session.settings
        here = Sample(
            "start", X_BT, seen.X_CT, seen.covariance, seen.corners_left, settings.marker_id, True, 0.0
        )
        planned = session.with_sample(here)
        belief = guided_sampling.believed(planned.pairs(), session.around, settings)
        choices = 0
        for number in range(settings.poses - 1):
            proposal = guided_sampling.propose(
                belief, session.around, settings, np.random.default_rng([session.seed, 1, number])
            )
            choices = choices or proposal.choices
            added = guided_sampling.information_of(proposal, belief, session.around, settings)
            belief = belief._replace(information=belief.information + added)
        return {
            "marker": marker_json(seen),
            "poses_in_view": f"{choices} of {settings.candidates}",
            "promised_std_mm": 1e3 * belief.std[0],
            "promised_std_deg": math.degrees(belief.std[1]),
            "verdict": f"marker {settings.marker_id} seen, 0/{settings.poses}: ready",
        }

    def resume(self, name: str) -> JSON:
        """Opens a session from the disk."""
        self._session = self.store.load(name, self._camera)
        self._last = self.X_TC = None
        self._log.write("hand_eye_resumed", session=name, samples=len(self._session.samples))
        return self.view()

    async def propose(self, informative: bool = True) -> JSON:
        """The next pose: the most informative one, or any that passes the bounds."""
        session = self.session
        if not session.samples:
            raise RequestRefused("refused.hand_eye.no_sample", "take a sample at the starting pose first")
        proposal = await self._pictures.aside(lambda: self._proposal(session, informative))
        now = self.session  # it may have lost a sample meanwhile
        self._open(replace(now, proposal=proposal, proposed=now.proposed + 1))
        return proposal_json(proposal)

    def _proposal(self, session: Session, informative: bool) -> Proposal:
        rng = np.random.default_rng([session.seed, 2, session.proposed])
        belief = self._belief(session)
        return guided_sampling.propose(
            belief, session.around, session.settings, rng, session.refused, informative
        )

    async def go(self, report: Report) -> JSON:
        """Drives to the proposed pose. One that the controller refuses is remembered, and the arm rests."""
        proposal = self.session.proposal
        if proposal is None:
            raise RequestRefused("refused.hand_eye.no_proposal", "no pose is proposed: propose one first")
        report(0.1, "moving")
        view = await self._driven(proposal.X_BT, learn=True)
        return {
            "X_BT_reached": pose_json(view.X_BT),
            "settled": view.settled,
            "off": off(view.X_BT, proposal.X_BT),
        }

    async def sample(self, report: Report, name: str | None = None) -> JSON:
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
        seen, view, moved = await self._look(session.settings)
        session = self.session
        if name is None:
            session, name = session.next_name()
        sample = _sample_of(name, seen, view.X_BT, session.settings, view.settled, moved)
        self._open(session.with_sample(sample))
        told = {
            "marker": marker_json(seen),
            "count": len(self.session.samples),
            "moved_mrad": round(moved, 3),
        }
        told |= await self._pictures.aside(lambda: self._judged(name))
        self._log.write("hand_eye_sample", session=session.name, sample=name, **told)
        return {"sample": name} | told

    def _judged(self, name: str) -> JSON:
        """The sample's residual by what is believed, and how well X is known."""
        session = self.session
        belief = self._belief(session)
        row = next(row for row in residuals(session, belief) if row["name"] == name)
        std_m, std_rad = belief.std
        return {
            "residual_mm": row["residual_mm"],
            "residual_deg": row["residual_deg"],
            "std_mm": 1e3 * std_m,
            "std_deg": math.degrees(std_rad),
        }

    async def redo(self, name: str, report: Report) -> JSON:
        """Drives back to a sample's pose and takes it again; the old one stays until the new one is there."""
        old = self.session.sample(name)
        report(0.1, f"moving back to sample {name}")
        await self._driven(old.X_BT, learn=False)
        return await self.sample(report, name)

    def remove(self, name: str) -> JSON:
        """Leaves out a sample for good."""
        self._open(self.session.without(name))
        self._log.write("hand_eye_removed", session=self.session.name, sample=name)
        return self.view()

    async def next_pose(self, report: Report, informative: bool = True) -> JSON:
        """Proposes and drives until the controller accepts a pose. Raises what it said last."""
        for left in reversed(range(_PATIENCE)):
            proposal = await self.propose(informative)
            try:
                return proposal | await self.go(report)
            except RequestRefused:
                # Only what the path survey refused was remembered; anything else must not be tried again.
                if left == 0 or self.session.proposal is not None:
                    raise
        raise AssertionError("unreachable")

    async def solve(self) -> JSON:
        """X by the certified robust solver with all that is known about it, others beside it, a verdict."""
        session = self.session
        if not session.samples:
            raise MeasurementFailed(
                "measurement.hand_eye.too_few_samples", "0 samples are too few: take some"
            )
        answer, self.X_TC = await self._pictures.aside(lambda: solved(session))
        self._log.write("hand_eye_solved", session=session.name, verdict=answer["verdict"])
        return answer

    async def locate(self, report: Report) -> JSON:
        """The cabinet's targets in the hand and in the base, seen from here, with the X solved last.

        Raises RequestRefused (``refused.hand_eye.not_solved``, ``.no_drawing``), MeasurementFailed as
        ``cabinet.locate``.
        """
        if self.X_TC is None:
            raise RequestRefused("refused.hand_eye.not_solved", "no X yet: solve first")
        drawing = self._drawing()
        report(0.2, "looking at the cabinet")
        await self._settled(self.defaults)
        pictures = await self._pictures.pairs_at_rest(1)
        places = await self._pictures.aside(lambda: self._seen_targets(pictures.pairs[0], drawing))
        X_BC = pictures.X_BT @ self.X_TC
        return {
            "X_BT": pose_json(pictures.X_BT),
            "targets": [
                {
                    "name": t.name,
                    "p_C_m": t.p_C.tolist(),
                    "p_T_m": se3.apply(self.X_TC, t.p_C[None])[0].tolist(),
                    "p_B_m": se3.apply(X_BC, t.p_C[None])[0].tolist(),
                    "gap_px": t.gap_px,
                    "correlation": t.correlation,
                }
                for t in places
            ],
        }

    def _seen_targets(self, pair: StereoPair, drawing: Drawing) -> tuple[Located, ...]:
        self._offset = observe(pair, self._camera, self._config.markers, self._offset)
        offset = self._offset.offset
        camera = self._camera
        if offset is not None:
            camera = with_offset(camera, offset.x_px, offset.y_px)
        return cabinet.locate(pair, drawing, camera)

    def _drawing(self) -> Drawing:
        if self._loaded is None:
            self._loaded = load_drawing(self._config.cabinet)
        return self._loaded

    def view(self) -> JSON:
        """The open session: its samples with residuals, and the proposal."""
        session = self.session
        belief = self._belief(session) if session.samples else None
        rows = [] if belief is None else residuals(session, belief)
        return {
            "name": session.name,
            "count": f"{len(session.samples)}/{session.settings.poses}",
            "complete": session.complete,
            "marker_id": session.settings.marker_id,
            "samples": rows,
            "std_mm": None if belief is None else 1e3 * belief.std[0],
            "std_deg": None if belief is None else math.degrees(belief.std[1]),
            "proposal": None if session.proposal is None else proposal_json(session.proposal),
            "refused": len(session.refused),
        }

    async def _look(self, settings: GuidedSettings) -> tuple[TargetLook, ArmView, float]:
        """The marker, the arm there, and by how many mrad an encoder moved meanwhile.

        Raises MeasurementFailed (``measurement.hand_eye.not_settled``, and what ``look_at_target`` raises).
        """
        before = await self._settled(settings)
        pictures = await self._pictures.pairs_at_rest(settings.frames)
        after = await self._arm.view()
        moved = 1e3 * float(np.abs(after.q_meas - before.q_meas).max())
        if moved > settings.moved_mrad or before.motion_id != after.motion_id:
            raise MeasurementFailed(
                "measurement.hand_eye.not_settled",
                f"the arm moved by {moved:.2f} mrad while the sample was taken, "
                f"limit {settings.moved_mrad:g} mrad",
            )
        known = target.target_settings(self._config.markers, settings)
        seen = await self._pictures.aside(
            lambda: target.look_at_target(
                pictures.pairs,
                self._camera,
                known,
                self._config.look,
                settings,
                self._last,
                frozenset(self._config.markers.sizes),
            )
        )
        self._last = seen.last
        return seen, after._replace(X_BT=pictures.X_BT), moved

    async def _settled(self, settings: GuidedSettings) -> ArmView:
        """The view once the controller's flag says settled, or the time for it has passed."""
        view = await self._arm.view()
        began_ns = view.time_ns
        while not view.settled and view.time_ns - began_ns < 1e9 * settings.settle_timeout_s:
            await self._states.next_state()
            view = await self._arm.view()
        return view

    async def _driven(self, X_BT: Array, learn: bool) -> ArmView:
        session = self.session
        try:
            return await self._arm.move_to(X_BT)
        except RequestRefused as error:
            if learn and error.cause in _IMPOSSIBLE:
                self._open(replace(session, proposal=None, refused=(*session.refused, (X_BT, str(error)))))
            raise

    def _belief(self, session: Session) -> Belief:
        return guided_sampling.believed(session.pairs(), session.around, session.settings)

    def _open(self, session: Session) -> None:
        self.store.save(session)
        self._session = session


_IMPOSSIBLE = {
    f"refused.{reason}"
    for reason in ("outside_workspace", "joint_limit", "unreachable", "singular", "too_fast", "too_far")
}


def _sample_of(
    name: str, seen: TargetLook, X_BT: Array, settings: GuidedSettings, settled: bool, moved: float
) -> Sample:
    return Sample(
        name, X_BT, seen.X_CT, seen.covariance, seen.corners_left, settings.marker_id, settled, moved
    )
