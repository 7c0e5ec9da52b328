"""Controllers that stream wrongly, each caught by the case meant for it."""

from controller.core.settings import ScanSettings
from protocol.reference_messages import State
from protocol.session_events import StreamedPoseReceived
from tests.conformance.controllers import ControllerUnderTest, settings
from tests.conformance.mutants import Mutant


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


STREAM_MUTANTS = (
    Mutant(WaitsForReferences, 572),
    Mutant(TakesNanForTheLast, 546),
    Mutant(TakesNanForTheLast, 553),
    Mutant(FollowsAnyStream, 554),
    Mutant(TakesOlderNumbers, 548),
    Mutant(IgnoresTheMeasurement, 549),
    Mutant(StandsStill, 550),
)
