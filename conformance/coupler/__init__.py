"""What the page says and no case asks, and why; the page's list is made from this one."""

from typing import NamedTuple


class Unasked(NamedTuple):
    """``what`` of a clause is not asked."""

    clause: str
    what: str
    why: str


UNASKED = (
    Unasked("2.6", "counters modulo 2^16", "65 536 requests take longer than all other cases"),
    Unasked("3.2", "the first character in the low byte", "the text of another coupler is not known"),
    Unasked("5.1", "1000 ms and trigger 1 at start", "no case starts the coupler anew"),
    Unasked("5.8", "that the valves are centred", "no case enables them"),
    Unasked("10.1", "one exchange a scan", "the controller's duty; the coupler's part is 2.8 and 3.1 here"),
    Unasked("10.2", "low word first, sign, worth of a digit", "what the sensors should tell is not known"),
    Unasked("10.8", "values beyond their range", "no case can bring a sensor there"),
)
