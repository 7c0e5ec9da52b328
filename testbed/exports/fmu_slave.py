"""The plant behind FMI 2.0: what PythonFMU runs in an FMU that `longreach export fmu` has made.

It stands in the FMU as it is here, and needs the Python environment in which Longreach is installed.
"""

from pathlib import Path
from typing import Any

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Real

from testbed.exports.fmu import JOINTS, outputs_of, plant_of, step


class LongreachPlant(Fmi2Slave):  # type: ignore[misc]  # it has no types
    """Six spool commands in; encoders, pressures, and what is true out. Radians, metres, pascals."""

    description = "Longreach: a hydraulic arm, its oil, valves, flexible booms and sensors"

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self._plant = plant_of(Path(self.resources) / "plant.json")
        self._steps = 0
        for joint in JOINTS:
            setattr(self, f"valve_{joint}", 0.0)
            self.register_variable(Real(f"valve_{joint}", causality=Fmi2Causality.input))
        for name, value in self._told().items():
            output = Real(name, causality=Fmi2Causality.output, initial=Fmi2Initial.exact, start=value)
            self.register_variable(output)

    def do_step(self, _time_s: float, step_s: float) -> bool:
        """Let ``step_s`` pass under the commands that were set."""
        self._steps += 1
        step(self._plant, self._steps, [getattr(self, f"valve_{joint}") for joint in JOINTS], step_s)
        self._told()
        return True

    def _told(self) -> dict[str, float]:
        """What is told now, put where PythonFMU reads it."""
        outputs = outputs_of(self._plant)
        self.__dict__.update(outputs)
        return outputs
