"""Exceptions that carry a machine-readable cause.

Taxonomy (every leaf names who is at fault):

    LongreachError                base; ``cause`` is a dotted, stable slug; ``str(error)`` one line
    ├── ConfigurationError        the configuration files or command line: what, where, value, limit
    ├── DatagramRefused           the peer sent bytes that the reference link does not accept
    ├── ImageRefused              the peer sent process-image words that cannot be decoded
    ├── FrameRefused              the camera stream sent a header that does not fit the format
    ├── RequestRefused            a well-formed request that the present state or the limits forbid
    ├── LinkLost                  a peer did not answer, or the connection ended
    ├── MotionUnsettled           a motion is done, but the arm does not come to rest
    └── MeasurementFailed         nothing could be measured (marker not seen, odometry lost, ill-conditioned)

Expected trouble inside a controller scan is not an exception but data: see ``protocol.faults``.
"""


class LongreachError(Exception):
    """Base of all errors that Longreach raises on purpose.

    ``cause`` is the machine-readable slug that the REST face, exit messages and event logs repeat unchanged.
    """

    def __init__(self, cause: str, message: str) -> None:
        super().__init__(message)
        self.cause = cause

    def __reduce__(self) -> tuple[type["LongreachError"], tuple[str, str]]:
        """How to make it again in another process."""
        return type(self), (self.cause, str(self))


class ConfigurationError(LongreachError):
    """A configuration key is unknown, missing, of the wrong type or out of range."""


class DatagramRefused(LongreachError):
    """A datagram of the reference link was not accepted; ``cause`` begins with ``datagram.``."""


class ImageRefused(LongreachError):
    """Process-image words are of the wrong count or torn; ``cause`` begins with ``image.``."""


class FrameRefused(LongreachError):
    """A stereo frame header does not fit the format; ``cause`` begins with ``frame.``."""


class RequestRefused(LongreachError):
    """A well-formed request that the present state or a limit forbids; ``cause`` begins with ``refused.``."""


class LinkLost(LongreachError):
    """A peer is missing or went silent; ``cause`` begins with ``link.``."""


class MotionUnsettled(LongreachError):
    """The arm swings on after its motion; ``cause`` begins with ``motion.``."""


class MeasurementFailed(LongreachError):
    """A measurement failed; ``cause`` begins with ``measurement.``. Never replaced by a zero."""
