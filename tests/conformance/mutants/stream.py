"""Controllers that stream wrongly, each caught by the case meant for it."""

from dataclasses import replace
from typing import Any

from controller.core.settings import ScanSettings
from protocol.datagram import Header
from protocol.faults import CommandCode
from protocol.reference_messages import CAPABILITY_STREAMING, Command, State, StreamedPose
from protocol.server_session import ReferenceServer
from protocol.session_events import ServerEvent, StreamedPoseReceived
from protocol.session_factory import LinkSession
from tests.conformance.controllers import ControllerUnderTest, settings
from tests.conformance.mutants.breaking import Mutant


class WaitsForReferences(ControllerUnderTest):
    """Goes on for most of a second without a reference."""

    def configured(self) -> ScanSettings:
        return settings("controller.streaming.silence_ms=900")


class TakesNanForTheLast(ControllerUnderTest):
    """Takes the reference before for one that is not finite, and so for a fresh one."""

    good: StreamedPoseReceived | None = None

    def judge_streamed(self, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
        if arrival.message.X_BT_ref.is_finite():
            self.good = arrival
            return arrival
        if self.good is None:
            return arrival
        pose = self.good.message.X_BT_ref
        return arrival._replace(message=arrival.message._replace(X_BT_ref=pose))


class FollowsAnyStream(ControllerUnderTest):
    """Does not look at the stream that a reference belongs to."""

    def judge_streamed(self, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
        stream = self.bench.state.stream
        if stream is None:
            return arrival
        return arrival._replace(message=arrival.message._replace(stream_id=stream.stream_id))


class TakesOlderNumbers(ControllerUnderTest):
    """Does not look at the number."""

    def judge_streamed(self, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
        stream = self.bench.state.stream
        if stream is None:
            return arrival
        return arrival._replace(message=arrival.message._replace(number=(stream.number + 1) % 2**32))


class IgnoresTheMeasurement(ControllerUnderTest):
    """Does not look at how old the measurement behind a reference is."""

    def judge_streamed(self, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
        return arrival._replace(measured_ns=arrival.left_ns)


class StandsStill(ControllerUnderTest):
    """Accepts streamed references, and shows another number than that of the newest."""

    def shown(self, state: State) -> State:
        return state._replace(stream_number=0)


def _with_streams(session: LinkSession) -> LinkSession:
    """``session`` as if it had asked for streams."""
    granted = session.welcome.capabilities | CAPABILITY_STREAMING
    return replace(session, welcome=session.welcome._replace(capabilities=granted))


class _Unasked(ReferenceServer):
    """Takes what only a session with STREAMING may send: ``code``, or streamed references when it is None."""

    code: CommandCode | None = None

    def _streamed(
        self, session: LinkSession, header: Header, message: StreamedPose, now_ns: int
    ) -> list[ServerEvent]:
        session = _with_streams(session) if self.code is None else session
        return super()._streamed(session, header, message, now_ns)

    def _requested(
        self, session: LinkSession, request: Any, content: bytes, now_ns: int
    ) -> list[ServerEvent]:
        if isinstance(request, Command) and request.code is self.code:
            session = _with_streams(session)
        return super()._requested(session, request, content, now_ns)


def _unasked(code: CommandCode | None) -> type[ReferenceServer]:
    return type("Unasked", (_Unasked,), {"code": code})


class StartsUnaskedStreams(ControllerUnderTest):
    """START_STREAM needs no capability."""

    server_class = _unasked(CommandCode.START_STREAM)


class EndsUnaskedStreams(ControllerUnderTest):
    """END_STREAM needs none."""

    server_class = _unasked(CommandCode.END_STREAM)


class JudgesUnaskedReferences(ControllerUnderTest):
    """STREAMED_POSE needs none."""

    server_class = _unasked(None)


STREAM_MUTANTS = (
    Mutant(StartsUnaskedStreams, 541),
    Mutant(EndsUnaskedStreams, 541),
    Mutant(JudgesUnaskedReferences, 541),
    Mutant(WaitsForReferences, 572),
    Mutant(TakesNanForTheLast, 546),
    Mutant(TakesNanForTheLast, 553),
    Mutant(FollowsAnyStream, 554),
    Mutant(TakesOlderNumbers, 548),
    Mutant(IgnoresTheMeasurement, 549),
    Mutant(StandsStill, 550),
)
