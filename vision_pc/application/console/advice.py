"""What to do about a cause: one sentence for the person who has to."""

_OF_CAUSE = {
    "fault.plant_link_lost": "Look after the fieldbus and the plant; then reset and enable.",
    "fault.plant_cycle_frozen": "The plant stands still: start it anew, then reset and enable.",
    "fault.reference_link_lost": "The link broke in motion. Reset and enable; repeat what was interrupted.",
    "fault.following_error": "Look for what blocks the joint, for load and oil; then reset and enable.",
    "fault.encoder_jump": "Check the encoder and its cable before you reset.",
    "fault.encoder_stuck": "Check the encoder, the valve and the oil supply before you reset.",
    "fault.joint_limit": "Reset and enable, then jog back into the range.",
    "fault.workspace_limit": "Reset and enable, then jog back into the workspace.",
    "fault.overspeed": "Ask for a longer time or a smaller step; then reset and enable.",
    "fault.supply_pressure_lost": "Start the pump and wait for pressure; then reset and enable.",
    "fault.plant_watchdog": "The plant closed its valves by itself: find out why, then reset and enable.",
    "fault.emergency_stop": "Make sure that all is safe; release, reset, enable.",
    "fault.numeric": "Tell the developers, with the record of this run. Reset and enable.",
    "fault.overrun": "Close other work on the controller's machine; then reset and enable.",
    "fault.plant_status": "Look at the plant's own status; mend it, then reset and enable.",
    "fault.reference_stale": "The vision PC was too slow: close other work; then reset and enable.",
    "link.plant_silent": "The controller does not hear the plant: look after the fieldbus and the plant.",
    "link.camera_missing": "Is the camera connected, or the emulator running?",
    "link.camera_silent": "No picture comes: check the camera and its cable. Nothing is measured meanwhile.",
    "link.camera_frozen": "The same picture comes again and again: start the camera anew.",
    "link.wrong_arm": "Vision and controller have different arm.yaml files: give both the same.",
    "link.session_occupied": "Another client holds the controller: end it, or wait.",
    "machine.overloaded": "Close other work on this machine.",
    "recording.unwritable": "Events cannot be recorded: look after the disk.",
    "refused.busy": "Wait for the operation that runs, or cancel it.",
    "refused.disabled": "Hold ENABLE first.",
    "refused.moving": "Wait until the arm rests, or stop it.",
    "refused.not_calibrated": "Run the calibration step first.",
    "refused.unreachable": "Choose a target within the arm's reach, or turn the tool.",
    "refused.joint_limit": "Go in smaller steps, or turn the tool.",
    "refused.outside_workspace": "Choose a target inside the workspace.",
    "refused.stopped": "Somebody stopped it. Repeat the step when you are ready.",
    "refused.role": "You may look and stop. To move the arm, sign in with the operator's token.",
    "measurement.object_not_seen": "Bring the object's markers into the left eye's picture, well lit.",
    "measurement.tool_not_seen": "Bring the tool's marker into the left eye's picture, well lit.",
    "measurement.tool_moved": "The tool is not where it was: straighten it, or show its marker once again.",
    "measurement.odometry_lost": "Too little texture, or too fast: light the scene, keep the view free.",
    "measurement.match_poor": "Repeat the local calibration with longer segments.",
    "motion.not_settled": "The arm still swings: wait, then repeat the step.",
}
_OF_AREA = {
    "fault": "Find the cause; then reset and enable.",
    "link": "Is the other side running, and reachable? The page goes on by itself when it is.",
    "measurement": "Check light, view and markers; then repeat the step.",
    "refused": "Nothing was moved. Change what is said, then repeat.",
    "recording": "Look after the disk.",
    "motion": "Wait until the arm rests, then repeat the step.",
}
_ELSE = "See the event log of the vision PC."


def advice(cause: str) -> str:
    """What to do about ``cause``; of a cause without a sentence of its own, that of its area."""
    return _OF_CAUSE.get(cause) or _OF_AREA.get(cause.partition(".")[0], _ELSE)
