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
    from testbed.campaigns.experiment import Experiment

GROUP = "longreach.experiments"
_CORRECTED = "positioning.corrected:BEST_MODE"
_SERVOING = "positioning.visual_servoing:LOOKING_AND_MOVING"
_PAPER_COST = "6 CPU s with the model, 90 with pictures"
PAPER_PARTS = {
    "table2": "Table 2, the line equation: errors of nine measurements, beside ours",
    "table3": "Table 3, the match's residuals, beside ours",
    "table4": "Table 4, trajectory matching: ten measurements of two inputs, beside ours",
    "fig5": "Figure 5, Euler angles before and after the orientation adjustment",
    "fig6": "Figure 6, the circle of the line equation",
    "fig7": "Figure 7, errors over the line equation",
    "fig8": "Figure 8, the matched trajectories",
    "fig9": "Figure 9, errors over two inputs after the match",
}
PAPER = "all tables and figures of Mäkinen et al. 2023 in one report"


class Entry(NamedTuple):
    """An experiment before it is loaded: what it shows, CPU time of a run, and where it is defined.

    ``places``: method → ``module:NAME``, the usual method first; modules are counted from ``package``.
    ``taken``: why an installed package's has no name of its own, else empty.
    """

    places: Mapping[str, str]
    shows: str
    cost: str
    package: str = "testbed.experiments."
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
            from testbed.campaigns.experiment import Experiment as Wanted

            loaded = of_type(Wanted, "a testbed.campaigns.experiment.Experiment", loaded)
        experiment: Experiment[Any, Any] = loaded
        return experiment


def _one(place: str, shows: str, cost: str) -> Entry:
    return Entry({"": place}, shows, cost)


_BEST_MODE = _one(
    _CORRECTED, "how often one look, corrected on the way, brings the tool within 5 mm over drawn scenarios",
    "30 CPU s",
)  # fmt: skip
_LOCALISATION = _one(
    "hand_eye.experiments:LOCALISATION",  # the same localisations: Fig. 5 their error, 6 their rate
    "errors and rates of localisation with every method, beside the paper's (Hua et al., Fig. 5 and 6)",
    "4 CPU s",
)

OURS = {
    "paper": _one("paper.campaign:PAPER", PAPER, _PAPER_COST),
    **{
        name: _one(f"paper.campaign:{name.upper()}", shows, _PAPER_COST)
        for name, shows in PAPER_PARTS.items()
    },
    "ablation": _one(
        "paper.ablation:ABLATION", "which error source makes which figure of the paper", _PAPER_COST
    ),
    "sweep": _one(
        "paper.sweep:SWEEP",
        "errors over payload, mount, distance, noise, texture, play, flexibility and latency",
        _PAPER_COST,
    ),
    "positioning": _BEST_MODE._replace(places={"corrected": _CORRECTED, "visual-servoing": _SERVOING}),
    "best-mode": _BEST_MODE,
    "looking-and-moving": _one(
        _SERVOING,
        "whether the closed loop at camera rate ends under 2 mm, beside look-then-move from the same start",
        "60 CPU s",
    ),
    "sensitivity": _one(
        "sensitivity.campaign:SENSITIVITY",
        "which source of error limits where the tool ends: Sobol indices with their intervals",
        "10 CPU s, 9 of the lab's and 13 of the real world's a sample, 64 samples",
    ),
    "changed-machine": _one(
        "positioning.changed:CHANGED_MACHINE",
        "what a changed valve, play, lens … does to one look, and to what was told before it",
        "30 CPU s",
    ),
    "rules": _one(
        "rules:RULES_EXPERIMENT",
        "what each rule is worth: the same emulated degraded machines with it and without it",
        "45 CPU s",
    ),
    "lockstep-demo": _one(
        "positioning.lockstep_demo:LOCKSTEP_DEMO",
        "how many demonstrations end under 10 and under 5 mm, after one look and after more",
        "60 CPU s",
    ),
    "eyes-measure": _one(
        "positioning.eyes_measure:EYES_MEASURE",
        "what rendered pictures do to corners and tracked points, for the eye model's file",
        "150 CPU s",
    ),
    "eyes-agree": _one(
        "positioning.eyes_agree:EYES_AGREE",
        "whether runs without pictures end as runs with them do, in pairs",
        "30 CPU s; 150 with pictures",
    ),
    "targets": _one(
        "targets.one_look:TARGETS",
        "how exactly holes and clicked places are known, how honestly, and what is refused",
        "0.4 CPU s",
    ),
    "hole-drives": _one(
        "targets.hole_drives:HOLE_DRIVES",
        "how far off the tool ends at drill holes that were found and clicked, by one look each",
        "30 CPU s a hole",
    ),
    "hua-fig5": _LOCALISATION,
    "hua-fig6": _LOCALISATION,
    "hua-fig7": _one(
        "hand_eye.experiments:NOISE_SWEEP",
        "how close to the Cramér-Rao bound each hand-eye method comes as noise grows (Hua et al., Fig. 7)",
        "4 CPU s a level of 200",
    ),
    "hua-intrinsics": _one(
        "hand_eye.experiments:INTRINSICS",
        "intrinsics of the paper's camera, emulated, and of OpenCV's pictures (Hua et al., Fig. 4)",
        "40 CPU s",
    ),
    "hand-eye-stress": _one(
        "hand_eye.experiments:STRESS",
        "what bad samples and small rotations do to every hand-eye method",
        "10 CPU s a block of 25",
    ),
    "hand-eye-guided": _one(
        "hand_eye.guided_campaign:GUIDED",
        "error of X, its covariance, samples needed and located targets of guided sessions",
        "60 CPU s",
    ),
    "marker-limits": _one(
        "markers.limits:MARKER_LIMITS",
        "how small, oblique, blurred and noisy markers may be, beside OpenCV and AprilTag",
        "0.6 CPU s",
    ),
    "odometry-matrix": _one(
        "odometry.matrix:ODOMETRY_MATRIX",
        "whether odometry is right or says so, before movers, gaps, darkness, blur, bad rectification",
        "8 CPU s",
    ),
    "stream-cuts": _one(
        "robustness.stream_cuts:STREAM_CUTS",
        "how soon valves and oil stop when the stream of references is cut",
        "1 CPU s",
    ),
    "controller-kills": _one(
        "robustness.controller_kills:CONTROLLER_KILLS",
        "whether the plant stops by itself when its controller is killed or suspended, in real time",
        "4 s of real time",
    ),
    "attacks": _one(
        "robustness.attacks.campaign:ATTACKS_EXPERIMENT",
        "whether a stranger's requests end a motion, delay a stop or stall the fieldbus, in real time",
        "35 s of real time an attack",
    ),
    "commissioning": _one(
        "robustness.commissioning:COMMISSIONING",
        "whether commissioning finds the valves of drawn machines, and tells its spread honestly",
        "20 to 35 CPU s a joint",
    ),
    "parking": _one(
        "resting.parking:PARKING",
        "how far the tool moves in ten minutes at rest, with either arm and either set of valves",
        "60 to 90 CPU s of ten minutes",
    ),
    "settle": _one(
        "resting.settle:SETTLE",
        "how long joints take into 0.3 mrad, by valves, law and what is known of the deadbands",
        "3 to 6 CPU s a motion, six motions a run",
    ),
    "plant-campaign": _one(
        "robustness.plant_campaign:PLANT_CAMPAIGN",
        "whether oil and energy balance in sudden stops, payload drops, end-stop impacts, pump losses",
        "2 CPU s",
    ),
    "identification": _one(
        "identification.drawn_plants:IDENTIFICATION",
        "whether `longreach identify` finds a plant's parameters, and is as sure as it may be",
        "90 CPU s",
    ),
}
"""Command → experiment; ``best-mode`` and ``looking-and-moving`` are the methods of ``positioning``."""


@cache
def catalogue() -> dict[str, Entry]:
    """Ours, and those that installed packages add; a name of ours stays ours."""
    others = {one.name: Entry({"": one.place}, f"of {one.package}", "–", "", one.taken) for one in added()}
    return {**others, **OURS}


@cache
def added() -> tuple[Declared, ...]:
    """What installed packages add, those too whose name is taken; nothing is loaded."""
    return tuple(declared(GROUP, OURS))
