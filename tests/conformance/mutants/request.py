"""Controllers wrong in what they make of requests, each with its case."""

from protocol.command_ledger import CommandLedger, Verdict
from protocol.datagram import decode
from protocol.errors import DatagramRefused
from protocol.faults import CommandCode
from protocol.reference_messages import (
    Acknowledgement,
    Command,
    ReferencePath,
    ReferencePose,
    Request,
)
from protocol.server_session import ReferenceServer
from tests.conformance.controllers import LINK_TIMEOUT_MS, ControllerUnderTest
from tests.conformance.mutants.breaking import Mutant, with_ledger


class DropsUnknownCommands(ControllerUnderTest):
    """Leaves an unknown command without an answer."""

    def incoming(self, data: bytes) -> bytes | None:
        try:
            message = decode(data).message
        except DatagramRefused:
            return data
        return None if type(message).__name__ == "UnusableRequest" else data


class _Forgetful(CommandLedger):
    def admit(self, command_id: int, payload: bytes) -> Verdict:
        self.__init__()
        return super().admit(command_id, payload)


class ExecutesRepetitions(ControllerUnderTest):
    """Forgets which commands it has executed."""

    def make_server(self) -> ReferenceServer:
        server = super().make_server()
        return with_ledger(server, _Forgetful)


class _LetsOlderIdsPass(CommandLedger):
    def admit(self, command_id: int, payload: bytes) -> Verdict:
        if command_id not in self._answered and command_id not in self._pending:
            self._newest_id = 0
        return super().admit(command_id, payload)


class LetsMotionsOvertake(ControllerUnderTest):
    """Executes an id below the newest."""

    def make_server(self) -> ReferenceServer:
        return with_ledger(super().make_server(), _LetsOlderIdsPass)


class _ById(CommandLedger):
    def admit(self, command_id: int, payload: bytes) -> Verdict:
        return super().admit(command_id, b"")


class LooksAtTheIdAlone(ControllerUnderTest):
    """Takes any request with a known id for a repetition."""

    def make_server(self) -> ReferenceServer:
        return with_ledger(super().make_server(), _ById)


class AnswersTwice(ControllerUnderTest):
    """Sends every acknowledgement twice, under two sequence numbers."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def acknowledge(self, acknowledgement: Acknowledgement, now_ns: int) -> None:
                super().acknowledge(acknowledgement, now_ns)
                self._send(acknowledgement, now_ns)

        return Server(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS)


class TakesNanForZero(ControllerUnderTest):
    """Puts 0 where a NaN came."""

    def judge(self, request: Request) -> Request:
        if not isinstance(request, ReferencePose):
            return request
        here = self.bench.last.view.X_BT_cmd
        sane = request.X_BT_ref if request.X_BT_ref.is_finite() else here
        duration = request.duration_s if abs(request.duration_s) < 1e6 else 0.0
        return request._replace(X_BT_ref=sane, duration_s=duration)


class NormalisesAnything(ControllerUnderTest):
    """Normalises every quaternion."""

    def judge(self, request: Request) -> Request:
        if not isinstance(request, ReferencePose) or not 0.0 < request.X_BT_ref.quaternion_norm() < 9.0:
            return request
        norm = request.X_BT_ref.quaternion_norm()
        w, x, y, z = request.X_BT_ref.q_wxyz
        unit = (w / norm, x / norm, y / norm, z / norm)
        return request._replace(X_BT_ref=request.X_BT_ref._replace(q_wxyz=unit))


class DrivesTheReachablePart(ControllerUnderTest):
    """Leaves out the waypoints that cannot be reached."""

    def judge(self, request: Request) -> Request:
        if not isinstance(request, ReferencePath):
            return request
        near = tuple(w for w in request.waypoints if abs(w.p_m[2]) < 10.0)
        return request._replace(waypoints=near)


class ForgetsTheEmergency(ControllerUnderTest):
    """A new session clears the emergency stop."""

    def incoming(self, data: bytes) -> bytes | None:
        if len(data) > 6 and data[6] == 1:
            self.bench.step(Command(1, CommandCode.EMERGENCY_RELEASE))
            self.bench.step(Command(2, CommandCode.RESET))
        return data


class ReleaseIsEnough(ControllerUnderTest):
    """EMERGENCY_RELEASE resets as well."""

    def judge(self, request: Request) -> Request:
        if isinstance(request, Command) and request.code is CommandCode.EMERGENCY_RELEASE:
            self.bench.step(request)
            return request._replace(code=CommandCode.RESET)
        return request


REQUEST_MUTANTS = (
    Mutant(DropsUnknownCommands, 123),
    Mutant(DropsUnknownCommands, 125),
    Mutant(AnswersTwice, 401),
    Mutant(LooksAtTheIdAlone, 404),
    Mutant(LetsMotionsOvertake, 405),
    Mutant(ForgetsTheEmergency, 508),
    Mutant(ReleaseIsEnough, 509),
    Mutant(ExecutesRepetitions, 510),
    Mutant(TakesNanForZero, 521),
    Mutant(NormalisesAnything, 522),
    Mutant(DrivesTheReachablePart, 526),
)
