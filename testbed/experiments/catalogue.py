"""Every experiment by the name of its command. Modules are loaded when one is asked for: most are heavy."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any, NamedTuple

from testbed.campaigns.experiment import Experiment

_PAPER = "paper.campaign"
_HAND_EYE = "hand_eye.experiments"
_CORRECTED = "positioning.corrected:BEST_MODE"
_SERVOING = "positioning.visual_servoing:LOOKING_AND_MOVING"


class Entry(NamedTuple):
    """Where an experiment is defined: method → ``module:NAME``, the usual method first."""

    places: Mapping[str, str]

    def load(self, method: str | None = None) -> Experiment[Any, Any]:
        """The experiment, by the usual method where none is named."""
        module, _, name = self.places[method or next(iter(self.places))].partition(":")
        loaded: Experiment[Any, Any] = getattr(import_module(f"testbed.experiments.{module}"), name)
        return loaded


def _one(place: str) -> Entry:
    return Entry({"": place})


CATALOGUE = {
    "paper": _one(f"{_PAPER}:PAPER"),
    **{
        name: _one(f"{_PAPER}:{name.upper()}")
        for name in ("table2", "table3", "table4", "fig5", "fig6", "fig7", "fig8", "fig9")
    },
    "ablation": _one("paper.ablation:ABLATION"),
    "sweep": _one("paper.sweep:SWEEP"),
    "positioning": Entry({"corrected": _CORRECTED, "visual-servoing": _SERVOING}),
    "best-mode": _one(_CORRECTED),
    "looking-and-moving": _one(_SERVOING),
    "changed-machine": _one("positioning.changed:CHANGED_MACHINE"),
    "lockstep-demo": _one("positioning.lockstep_demo:LOCKSTEP_DEMO"),
    "eyes-measure": _one("positioning.eyes_measure:EYES_MEASURE"),
    "eyes-agree": _one("positioning.eyes_agree:EYES_AGREE"),
    "targets": _one("targets.one_look:TARGETS"),
    "path-information": _one("positioning.path_information:PATH_INFORMATION"),
    "hua-fig5": _one(f"{_HAND_EYE}:LOCALISATION"),
    "hua-fig6": _one(f"{_HAND_EYE}:LOCALISATION"),  # the same localisations: Fig. 5 their error, 6 their rate
    "hua-fig7": _one(f"{_HAND_EYE}:NOISE_SWEEP"),
    "hua-intrinsics": _one(f"{_HAND_EYE}:INTRINSICS"),
    "hand-eye-stress": _one(f"{_HAND_EYE}:STRESS"),
    "hand-eye-guided": _one("hand_eye.guided_campaign:GUIDED"),
    "odometry-matrix": _one("odometry.matrix:ODOMETRY_MATRIX"),
    "stream-cuts": _one("robustness.stream_cuts:STREAM_CUTS"),
    "controller-kills": _one("robustness.controller_kills:CONTROLLER_KILLS"),
    "attacks": _one("robustness.attacks.campaign:ATTACKS_EXPERIMENT"),
    "commissioning": _one("robustness.commissioning:COMMISSIONING"),
    "parking": _one("resting.parking:PARKING"),
    "settle": _one("resting.settle:SETTLE"),
    "plant-campaign": _one("robustness.plant_campaign:PLANT_CAMPAIGN"),
    "identification": _one("identification.drawn_plants:IDENTIFICATION"),
}
"""Command → experiment; ``best-mode`` and ``looking-and-moving`` are the methods of ``positioning``."""
