"""The controller's program: the scan as ever or, chosen at start, the scan that tries out valves."""

from collections.abc import Callable

from controller.config import ControllerConfig
from controller.core.excitation.plan import excitation_plan
from controller.core.excitation.program import ExcitationProgram, ExcitationSample, excitation_scan
from controller.core.scan import scan
from controller.core.scan_types import ScanInput, ScanOutput, ScanState, initial_state
from controller.core.settings import settings_from
from foundation.configuration import configuration_hash
from nominal_arm.description import NominalArm
from protocol.authentication import LinkKey
from protocol.errors import ConfigurationError
from protocol.reference_messages import CAPABILITY_PATHS, CAPABILITY_STREAMING, CAPABILITY_VALVE_TRIALS
from protocol.server_session import ReferenceServer


class ScanProgram:
    """The scan with its state; the service and lockstep run this same class.

    ``plan`` is None unless valves are tried out. Then ``excitation`` is where that stands, and ``samples``
    what it recorded since they were last taken.
    """

    def __init__(self, arm: NominalArm, config: ControllerConfig) -> None:
        """Raises ConfigurationError as ``settings_from`` does."""
        self.settings = settings_from(arm, config)
        self.plan = excitation_plan(arm, config)
        self.samples: list[ExcitationSample] = []
        self._state = initial_state(self.settings)
        self.excitation = ExcitationProgram(self._state)

    @property
    def capabilities(self) -> int:
        """What is granted to a client; one that was granted trials knows what ENABLE begins."""
        follows = CAPABILITY_PATHS | CAPABILITY_STREAMING
        return follows if self.plan is None else follows | CAPABILITY_VALVE_TRIALS

    @property
    def state(self) -> ScanState:
        """The scan's state."""
        return self._state if self.plan is None else self.excitation.inner

    def scan(self, inputs: ScanInput) -> ScanOutput:
        """What one scan of ``inputs`` puts out."""
        if self.plan is None:
            self._state, output = scan(self.settings, self._state, inputs)
            return output
        self.excitation, output, sample = excitation_scan(self.settings, self.plan, self.excitation, inputs)
        if sample is not None:
            self.samples.append(sample)
        return output


Parts = Callable[[NominalArm, ControllerConfig, int, LinkKey | None], tuple[ScanProgram, ReferenceServer]]
"""Makes scan and sessions of an arm's configuration, the number of the start and the link's key."""


def own_parts(
    arm: NominalArm, config: ControllerConfig, boot_id: int, key: LinkKey | None
) -> tuple[ScanProgram, ReferenceServer]:
    """The scan and the sessions of this package.

    Raises ConfigurationError as ``settings_from`` does, and for ADS, which it does not speak.
    """
    if config.ads.port:
        why = (
            "controller.ads.port: only the controller in structured text shows its variables: --controller st"
        )
        raise ConfigurationError("configuration.no_ads", why)
    program = ScanProgram(arm, config)
    server = ReferenceServer(
        boot_id=boot_id,
        arm_hash=configuration_hash(arm),
        cycle_ns=round(1e6 * config.cycle_ms),
        link_timeout_ms=config.reference_link.link_timeout_ms,
        capabilities=program.capabilities,
        key=key,
    )
    return program, server
