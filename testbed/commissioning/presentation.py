"""What commissioning found, as a table and a picture a joint."""

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure
from rich.table import Table

from controller.core.excitation.plan import StrokeKind
from nominal_arm.description import JOINT_NAMES
from testbed.commissioning.findings import JointFindings
from testbed.commissioning.ramp_rows import smoothed_speed
from testbed.commissioning.recording import JointRecording, strokes_in
from testbed.commissioning.session import ToldNumber, TrialsTold
from testbed.commissioning.uncertain import Uncertain
from testbed.commissioning.valve_fit import EdgeFindings
from testbed.reporting.console import table
from testbed.reporting.plots import AXIS_COLOURS, JOINTS

_OF_EDGES = (
    "joint", "sense", "deadband %", "hysteresis %", "lag ms", "response ms", "flow / nominal", "curve",
    "left mrad",
)  # fmt: skip
_OF_JOINTS = ("joint", "friction bar", "load bar", "half play mrad", "travel mrad", "s")


def findings_tables(found: Mapping[int, JointFindings], seen: TrialsTold | None = None) -> list[Table]:
    """One row an edge, then one a joint; spools in per cent of the full one, numbers ± standard deviation.

    ``seen``: plays that the vision PC told, where no odometry is in the recordings.
    """
    edges = [
        ("" if sense == "lowering" else JOINTS[joint], *_edge_cells(sense, edge))
        for joint, one in sorted(found.items())
        for sense, edge in (("raising", one.raising), ("lowering", one.lowering))
    ]
    told = {} if seen is None else {str(name): one for name, one in seen.play_mrad.items()}
    joints = [
        (JOINTS[joint], *_joint_cells(one, told.get(JOINT_NAMES[joint])))
        for joint, one in sorted(found.items())
    ]
    return [
        table("commissioning: valves, value ± standard deviation", _OF_EDGES, edges),
        table("commissioning: joints", _OF_JOINTS, joints),
    ]


def _edge_cells(sense: str, edge: EdgeFindings) -> tuple[str, ...]:
    return (
        f"{sense}, by its outlet" if edge.by_outlet else sense,
        _told(edge.deadband, 100.0, 3),
        _told(edge.hysteresis, 100.0, 2),
        _told(edge.lag, 1e3, 0),
        _told(edge.response, 1e3, 0),
        _told(edge.gain, 1.0, 3),
        f"{edge.curvature:+.2f}",
        f"{1e3 * edge.residual:.3f}",
    )


def _joint_cells(one: JointFindings, told: ToldNumber | None) -> tuple[str, ...]:
    return (
        _told(one.friction.friction, 1.0, 1),
        _told(one.friction.load, 1.0, 1),
        _play_told(one, told),
        f"{1e3 * one.travel:.0f}",
        f"{one.seconds:.0f}",
    )


def _play_told(one: JointFindings, by_vision: ToldNumber | None) -> str:
    if one.play is None:
        return one.unseen if by_vision is None else _told(Uncertain(by_vision.value, by_vision.std), 1.0, 3)
    told = _told(Uncertain(one.play.half, one.play.half_std), 1e3, 3)
    return told if one.resolved else f"{told} (not to 20 %)"


def _told(number: Uncertain, unit: float, digits: int) -> str:
    return f"{unit * number.value:.{digits}f} ± {unit * number.std:.{digits}f}"


def findings_figures(found: Mapping[int, JointFindings]) -> dict[str, Any]:
    """The same numbers for a JSON file, SI and bar, by joint."""
    return {JOINTS[joint]: one._asdict() for joint, one in sorted(found.items())}


def joint_figure(recording: JointRecording, found: JointFindings, compensated: bool) -> Figure:
    """Speed over spool of every triangle with the fitted flow, and load pressure over speed."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    flow, load = figure.subplots(1, 2)
    for stroke in strokes_in(recording, compensated):
        if stroke.kind is not StrokeKind.RAMP:
            continue
        speed, sense = smoothed_speed(stroke), stroke.sense
        colour = AXIS_COLOURS[0] if sense > 0.0 else AXIS_COLOURS[1]
        flow.plot(100.0 * sense * stroke.u, 1e3 * sense * speed, color=colour, linewidth=0.6, alpha=0.6)
        load.plot(1e3 * sense * speed, sense * stroke.load, color=colour, linewidth=0.6, alpha=0.6)
    for sense, edge in ((1.0, found.raising), (-1.0, found.lowering)):
        for spool, relative in edge.flow:
            nominal = float(recording.full_speed[:, 0 if sense > 0.0 else 1].mean())
            flow.plot(100.0 * sense * spool, 1e3 * sense * relative * nominal, "ks", markersize=3)
        flow.axvline(100.0 * sense * edge.deadband.value, color="0.4", linestyle="--", linewidth=0.8)
    flow.set_xlabel("spool %")
    flow.set_ylabel("speed mrad/s")
    flow.set_title(f"{JOINTS[recording.joint]}: triangles, steps (squares), deadbands (dashed)", fontsize=9)
    load.set_xlabel("speed mrad/s")
    load.set_ylabel("load pressure bar")
    return figure
