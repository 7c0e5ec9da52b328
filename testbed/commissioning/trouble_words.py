"""What broke an excitation off, as one line: what, which joint, value and limit in units a person reads."""

from typing import NamedTuple

from controller.core.excitation.plan import Trouble
from nominal_arm.description import JOINT_NAMES


class TroubleWords(NamedTuple):
    """What happened, and how its value is told: times ``scale`` in ``unit``."""

    what: str
    scale: float
    unit: str


_MRAD = (1e3, "mrad")
_MRAD_S = (1e3, "mrad/s")
_SPOOL = (100.0, "% of the spool")
WORDS = {
    "no_motion": TroubleWords("does not move: a valve stuck or unplugged, or an encoder", *_SPOOL),
    "wrong_way": TroubleWords("turns against its valve word: valve or encoder is swapped", *_MRAD),
    "blocked": TroubleWords("stands still under its open valve: a stop, or something in the way", *_MRAD),
    "oscillates": TroubleWords("swings to and fro: a load-holding valve, or soft oil", 1.0, "reversals"),
    "not_at_rest": TroubleWords("does not come to rest behind its closed valve", *_MRAD_S),
    "too_far": TroubleWords("turned too far in one stroke", *_MRAD),
    "too_fast": TroubleWords("turned too fast", *_MRAD_S),
    "too_slow": TroubleWords("took too long for one stroke", 1.0, "s"),
    "joint_limit": TroubleWords("reached the end of its range", *_MRAD),
    "no_room": TroubleWords("stands too near the end of its range for a stroke", *_MRAD),
    "pressure": TroubleWords("a chamber's pressure is too high", 1.0, "bar"),
    "other_joint_moved": TroubleWords("another joint moved meanwhile", *_MRAD),
}
"""By cause, without its ``commissioning.``."""


def trouble_words(trouble: Trouble) -> str:
    """``cause: joint: what: value, limit``, without a stop at its end."""
    words = WORDS.get(trouble.cause.removeprefix("commissioning."))
    if words is None:  # stopped from outside, or a controller's that knows more than we do
        return f"{trouble.cause}: {JOINT_NAMES[trouble.joint]}"
    value, limit = words.scale * trouble.value, words.scale * trouble.limit
    told = f"{value:.4g} {words.unit}, limit {limit:.4g}"
    return f"{trouble.cause}: {JOINT_NAMES[trouble.joint]}: {words.what}: {told}"
