"""Every experiment by the name of its command: what it shows and what a run of it costs.

Modules are loaded when one is asked for: most are heavy.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from laboratory.campaigns.experiment import Experiment


class Entry(NamedTuple):
    """An experiment before it is loaded: what it shows, CPU time of a run, and where it is defined.

    ``places``: method → ``module:NAME``, the usual method first; modules are counted from this package.
    """

    places: Mapping[str, str]
    shows: str
    cost: str

    def load(self, method: str | None = None) -> "Experiment[Any]":
        """The experiment, by the usual method where none is named."""
        module, _, name = self.places[method or next(iter(self.places))].partition(":")
        experiment: Experiment[Any] = getattr(import_module(f"{__package__}.{module}"), name)
        return experiment


CATALOGUE = {
    "paper": Entry(
        {"": "paper.campaign:PAPER"},
        "tables and figures of Mäkinen et al. 2023 beside ours, all or some",
        "6 CPU s with the model, 90 with pictures",
    ),
    "hua": Entry(
        {
            "localisation": "hand_eye.hua:LOCALISATION",
            "noise": "hand_eye.hua:NOISE",
            "stress": "hand_eye.stress:STRESS",
        },
        "every hand-eye method beside Hua et al.: errors and rates of localisation (Fig. 5 and 6), errors as"
        " noise grows beside the Cramér-Rao bound (Fig. 7), or bad samples and small rotations",
        "4 CPU s, 10 a block of 25 of stress",
    ),
    "positioning": Entry(
        {
            "corrected": "positioning.corrected:CORRECTED",
            "programs": "positioning.programs:PROGRAMS",
        },
        "how near the tool comes over drawn machines: by one look corrected on the way, or by any programs",
        "30 to 60 CPU s",
    ),
    "hole-drives": Entry(
        {"": "targets.hole_drives:HOLE_DRIVES"},
        "how far off the tool ends at drill holes over drawn machines, by one look each",
        "30 CPU s a hole",
    ),
    "parking": Entry(
        {"": "robustness.parking:PARKING"},
        "whether the tool stays while SETTLED says so, in ten minutes at rest",
        "60 to 90 CPU s of ten minutes",
    ),
    "commissioning": Entry(
        {"": "robustness.commissioning:COMMISSIONING"},
        "whether commissioning finds the valves of drawn machines, and tells its spread honestly",
        "20 to 35 CPU s a joint",
    ),
}
"""Command → experiment."""
