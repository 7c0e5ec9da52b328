"""Every experiment by the name of its command: what it shows and what a run of it costs.

Modules are loaded when one is asked for: most are heavy. Installed packages add experiments of their own by
entry points of the group ``longreach.experiments``: name = ``module:EXPERIMENT``.
"""

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

from foundation.extensions import Declared, declared, of_type
from protocol.errors import ConfigurationError

if TYPE_CHECKING:
    from laboratory.campaigns.experiment import Experiment

GROUP = "longreach.experiments"


class Entry(NamedTuple):
    """An experiment before it is loaded: what it shows, CPU time of a run, and where it is defined.

    ``places``: method → ``module:NAME``, the usual method first; modules are counted from ``package``.
    ``taken``: why an installed package's has no name of its own, else empty.
    """

    places: Mapping[str, str]
    shows: str
    cost: str
    package: str = "laboratory.experiments."
    taken: str = ""

    def load(self, method: str | None = None) -> "Experiment[Any, Any]":
        """The experiment, by the usual method where none is named.

        Raises ConfigurationError (``extension.…``) where an installed package has none there.
        """
        if self.taken:
            raise ConfigurationError("extension.name_taken", self.taken)
        module, _, name = self.places[method or next(iter(self.places))].partition(":")
        try:
            loaded: Any = getattr(import_module(self.package + module), name)
        except Exception as error:
            if not self.package:  # foreign code: whatever it raises is its own fault
                why = f"{module}:{name}: {type(error).__name__}: {error}"
                raise ConfigurationError("extension.not_loaded", why) from error
            raise
        if not self.package:
            from laboratory.campaigns.experiment import Experiment as Wanted

            loaded = of_type(Wanted, "a laboratory.campaigns.experiment.Experiment", loaded)
        experiment: Experiment[Any, Any] = loaded
        return experiment


def _one(place: str, shows: str, cost: str) -> Entry:
    return Entry({"": place}, shows, cost)


OURS = {
    "paper": _one(
        "paper.campaign:PAPER",
        "tables and figures of Mäkinen et al. 2023 beside ours, all or some, in one report",
        "6 CPU s with the model, 90 with pictures",
    ),
    "positioning": Entry(
        {
            "corrected": "positioning.corrected:CORRECTED",
            "visual-servoing": "positioning.programs:VISUAL_SERVOING",
            "programs": "positioning.programs:PROGRAMS",
        },
        "how near the tool comes over drawn machines: by one look corrected on the way, by the closed"
        " loop at camera rate, or by any programs",
        "30 to 60 CPU s",
    ),
    "sensitivity": _one(
        "positioning.sensitivity:SENSITIVITY",
        "which source of error limits where the tool ends: Sobol indices with their intervals",
        "10 CPU s, 9 of the lab's and 13 of the real world's a sample, 64 samples",
    ),
    "eyes-measure": Entry(
        {"model": "positioning.eyes_measure:EYES_MEASURE", "markers": "markers.limits:MARKER_LIMITS"},
        "what rendered pictures do to corners and tracked points, for the eye model's file; or how small,"
        " oblique, blurred and noisy markers may be, beside OpenCV and AprilTag",
        "150 CPU s; a marker 0.6",
    ),
    "targets": Entry(
        {"looks": "targets.one_look:TARGETS", "hole-drives": "targets.hole_drives:HOLE_DRIVES"},
        "how exactly holes and clicked places are known, how honestly, and what is refused; or how far off"
        " the tool ends at drill holes, by one look each",
        "0.4 CPU s a look, 30 a hole",
    ),
    "hua": Entry(
        {"localisation": "hand_eye.hua:LOCALISATION", "noise": "hand_eye.hua:NOISE"},
        "every hand-eye method beside Hua et al.: errors and rates of localisation (Fig. 5 and 6), or errors"
        " as noise grows beside the Cramér-Rao bound (Fig. 7)",
        "4 CPU s",
    ),
    "hand-eye": Entry(
        {
            "guided": "hand_eye.guided_campaign:GUIDED",
            "stress": "hand_eye.stress:STRESS",
            "real-sets": "hand_eye.real_sets:REAL_SETS",
        },
        "hand-eye calibration: guided sessions over drawn worlds; bad samples and small rotations; or"
        " recordings of real arms, each beside the classical methods",
        "60 CPU s a session, 10 a block of 25, 5 a recording",
    ),
    "odometry": _one(
        "odometry.matrix:ODOMETRY",
        "whether odometry is right or says so, before movers, gaps, darkness, blur, bad rectification",
        "8 CPU s",
    ),
    "rules": _one(
        "rules:RULES_EXPERIMENT",
        "what each rule is worth: the same emulated degraded machines with it and without it",
        "45 CPU s",
    ),
    "parking": _one(
        "robustness.parking:PARKING",
        "how long joints take into 0.3 mrad, and how far the tool moves in ten minutes at rest",
        "60 to 90 CPU s of ten minutes",
    ),
    "robustness": Entry(
        {
            "stream-cuts": "robustness.stream_cuts:STREAM_CUTS",
            "controller-kills": "robustness.controller_kills:CONTROLLER_KILLS",
            "attacks": "robustness.attacks:ATTACKS_EXPERIMENT",
        },
        "how soon the arm stops when references are cut, or its controller killed or suspended; or what a"
        " stranger's requests do to motions and stops",
        "1 CPU s; 4 s of real time; 35 s of real time",
    ),
    "commissioning": _one(
        "robustness.commissioning:COMMISSIONING",
        "whether commissioning finds the valves of drawn machines, and tells its spread honestly",
        "20 to 35 CPU s a joint",
    ),
    "identification": _one(
        "robustness.identification:IDENTIFICATION",
        "whether `longreach identify` finds a plant's parameters, and is as sure as it may be",
        "90 CPU s",
    ),
    "validation": Entry(
        {
            "known-answers": "known_answers:KNOWN_ANSWERS",
            "rough": "rough_treatment:ROUGH",
        },
        "the plant against cases with known answers; or whether oil and energy balance in sudden stops,"
        " payload drops, end-stop impacts, pump losses",
        "1 min in all; 2 CPU s",
        "laboratory.validation.",
    ),
}
"""Command → experiment."""


@cache
def catalogue() -> dict[str, Entry]:
    """Ours, and those that installed packages add; a name of ours stays ours."""
    others = {one.name: Entry({"": one.place}, f"of {one.package}", "–", "", one.taken) for one in added()}
    return {**others, **OURS}


@cache
def added() -> tuple[Declared, ...]:
    """What installed packages add, those too whose name is taken; nothing is loaded."""
    return tuple(declared(GROUP, OURS))
