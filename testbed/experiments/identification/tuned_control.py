"""A controller tuned on a plant file, on the plant that the file was identified from.

Tuned means: it knows the file's deadbands, hysteresis, flows and delays, as commissioning would tell them,
and has the gains that its margins leave at that lag. Compared is how the tool follows one motion.
"""

import numpy as np

from controller.config import ControllerConfig
from controller.core.settings import settings_from
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES
from plant_emulator.core.plant import Plant
from protocol.errors import MeasurementFailed
from protocol.faults import FaultCode, Reason
from protocol.pose import Pose
from protocol.reference_messages import ReferencePose
from testbed.experiments.positioning.stated import full_flow, stated_valve, tuned_gains
from testbed.lockstep.core_loop import ClosedLoop
from testbed.scenarios.settings import Settings

_WAY_M = (0.05, 0.25, -0.15)  # [D] moves slew, lift and tilt, both ways
_AFTER_S = 2.0


def tuned_to(settings: Settings, plant: PlantConfig) -> ControllerConfig:
    """The controller of ``settings`` as it would be tuned on ``plant``.

    Nominal speeds are those of ``settings.plant``: where flow goes with the load, only what ``plant`` has
    more or less of it is told.
    """
    controller, told = settings.controller, {}
    compensated = plant.valves.compensator_bar > 0.0
    for name, drive in zip(JOINT_NAMES, settings.arm.drives, strict=True):
        actuator, usual = getattr(plant.actuators, name), getattr(settings.plant.actuators, name)
        valve = plant.valves.of(name, actuator.rated_flow_l_min)
        nominal = settings.plant.valves.of(name, usual.rated_flow_l_min)
        more = (
            valve.flow_extend_l_min / nominal.flow_extend_l_min,
            valve.flow_retract_l_min / nominal.flow_retract_l_min,
        )
        gains = full_flow(valve, actuator, drive) if compensated else more
        told[name] = stated_valve(None, valve, gains, getattr(controller.valves, name))
    fitted = {"name": plant.valve_set, "pressure_compensated": compensated}
    known = controller.valves.model_copy(update=told | fitted)
    tuning = tuned_gains(known, settings)
    control = controller.joint_control.model_copy(update={"gain_1_s": tuning.gain_1_s})
    return controller.model_copy(update={"valves": known, "joint_control": control})


def followed_mm(settings: Settings, plant: PlantConfig, controller: ControllerConfig, seed: int) -> float:
    """How far (mm rms) the tool is from its reference, by the encoders, over one motion of ``plant`` and two
    seconds after it. Raises MeasurementFailed with the controller's fault."""
    loop = ClosedLoop(settings_from(settings.arm, controller), Plant(plant, seed))
    loop.enable()
    start = loop.view.X_BT
    x, y, z = (float(p) for p in np.add(start.p_m, _WAY_M))
    reason = loop.refer(lambda number: ReferencePose(number, Pose((x, y, z), start.q_wxyz), 0.0))
    if reason is not Reason.ACCEPTED:
        raise MeasurementFailed("tuned.refused", f"the motion was refused: {reason.name.lower()}")
    missed: list[float] = []
    left = round(_AFTER_S / loop.settings.cycle_s)
    while left > 0:
        view = loop.step().view
        if view.fault is not FaultCode.NONE:
            raise MeasurementFailed(f"fault.{view.fault.name.lower()}", f"after {1e-9 * loop.now_ns:.1f} s")
        missed.append(float(np.linalg.norm(np.subtract(view.X_BT.p_m, view.X_BT_cmd.p_m))))
        left -= view.motion_done
    return 1e3 * float(np.sqrt(np.mean(np.square(missed))))
