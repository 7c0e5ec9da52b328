"""Joint control: from desired joint motion to spool commands.

Source: Mäkinen et al. 2023, (6) u = K_v (q_d − q), and (25), the PT-1 element on lift and tilt.
"""

import math
from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import Array
from foundation.compiled import kernel

_TURN = 0.1  # [D] of the hysteresis: a command that comes back by less has not turned


@kernel
def opening_for(curve: Array, flow: float) -> float:
    """The opening beyond the deadband that passes ``flow``, both shares (≥ 0) of the full ones.

    ``curve``: knots (n, 2) of opening and flow that rise in both, the first (0, 0); beyond the last its slope
    goes on.
    """
    k, last = 0, curve.shape[0] - 2
    while k < last and flow > curve[k + 1, 1]:
        k += 1
    slope = (curve[k + 1, 0] - curve[k, 0]) / (curve[k + 1, 1] - curve[k, 1])
    return float(curve[k, 0] + (flow - curve[k, 1]) * slope)


@kernel
def without_play(target: float, half: float, sense: float, furthest: float) -> tuple[float, float, float]:
    """The command that brings a spool with ``half`` a hysteresis to ``target``, and what to remember of it.

    ``sense``, ``furthest``: which way the command went before (±1), and how far. The inverse of the play
    operator leads by half its width; it turns over when ``target`` has come back by a tenth of the width, so
    that noise does not throw the spool to and fro.
    """
    if half <= 0.0:
        return target, sense, furthest
    if sense * (target - furthest) >= 0.0:
        furthest = target
    elif sense * (furthest - target) > 2.0 * _TURN * half:
        sense, furthest = -sense, target
    return target + sense * half, sense, furthest


@kernel
def pt1_step(value: float, target: float, time_constant: float, dt_s: float) -> float:
    """The output one sample later of (25), G(s) = 1/(τ s + 1), its input ``target`` held over the sample.

    Exact for a zero-order hold: y⁺ = e^(−T/τ) y + (1 − e^(−T/τ)) u. A time constant of 0 passes the input on.
    """
    if time_constant <= 0.0:
        return target
    decay = math.exp(-dt_s / time_constant)
    return decay * value + (1.0 - decay) * target


class JointFilters(NamedTuple):
    """What joint control keeps between scans, each (6,).

    ``pt1``: elements (25) (rad/s); ``load``: slow load pressures (bar). ``sense``, ``furthest``: the spool's
    last way, see ``without_play``. ``pilot``: slow pilot pressures while lowering (bar), 0 before the first.
    """

    pt1: Array
    load: Array
    sense: Array
    furthest: Array
    pilot: Array


class LoadHolding(NamedTuple):
    """How loads are lowered through load-holding valves, see ``pilot_share``.

    ``damping`` (6,): rad/s per bar of pilot pressure, 0 where none is fitted; ``high_pass`` (s): of it;
    ``slowest`` (rad/s): in full force from this speed on. ``setting`` (bar): of the load's pressure and
    ``lifted`` (6,) times the pilot pressure, at which the valve opens by its data sheet.
    """

    damping: Array
    high_pass: float
    slowest: float
    setting: float
    lifted: Array


class Pressures(NamedTuple):
    """Pressures (6,), bar, referred to chamber a: ``load`` as from ``drives.load_pressures``; ``pilot`` of
    chamber b alone, which opens a load-holding valve at chamber a."""

    load: Array
    pilot: Array


class JointGains(NamedTuple):
    """Constants of joint control; arrays are (6,), or (6, 2): raising and lowering.

    ``gain`` k (1/s); ``time_constant`` of the PT-1 (s, 0 for none); ``damping`` (rad/s per bar) behind a
    high pass of ``high_pass`` (s); ``deadband`` (6, 2) of spool, faded in over ``blend``; ``flow_gain``
    (6, 2): joint speed beyond it over the nominal one; ``curve`` (6, 2, n, 2): knots of opening and flow;
    ``half_play`` of spool; ``limit`` of spool; ``holding``: see LoadHolding.
    """

    gain: Array
    time_constant: Array
    feed_forward: float
    damping: Array
    high_pass: float
    deadband: Array
    flow_gain: Array
    blend: Array
    curve: Array
    half_play: Array
    limit: float
    holding: LoadHolding


def unmoved(load: Array, pilot: Array) -> JointFilters:
    """The filters of valves at rest under ``load`` (6,); ``pilot`` (6,): what lowering took before."""
    return JointFilters(np.zeros(6), load, np.ones(6), np.zeros(6), pilot)


@kernel
def pilot_share(
    holding: LoadHolding, i: int, slow: float, felt: Pressures, qd_cmd: float, dt_s: float
) -> tuple[float, float]:
    """What the pilot pressure of joint ``i`` adds to its demand (rad/s), and the slow pilot pressure (bar).

    A load-holding valve keeps the load's oil until the pressure that drives the joint down opens it, and
    follows that pressure late. Oil that only raises the pressure is no speed: a joint that waits for it gets
    more and more, and runs away when the valve is open at last. So the demand follows the pressure that
    lowering took before: it is filled up to that at once, and what is above or below it is damped. The slow
    pressure is kept while nothing is lowered; before the first time the data sheet says it.
    """
    share = min(1.0, max(0.0, -qd_cmd / holding.slowest))
    if holding.damping[i] <= 0.0 or share <= 0.0:
        return 0.0, slow
    pilot, before = felt.pilot[i], slow
    if slow <= 0.0:
        before = max(pilot, (holding.setting - felt.load[i] - pilot) / holding.lifted[i])
    return (
        share * holding.damping[i] * (pilot - before),
        pt1_step(before, pilot, holding.high_pass / share, dt_s),
    )


@kernel
def valve_commands(
    gains: JointGains,
    filters: JointFilters,
    error: Array,
    qd_cmd: Array,
    felt: Pressures,
    speeds: Array,
    dt_s: float,
) -> tuple[Array, JointFilters]:
    """Spool commands (6,) and the filters for the next sample.

    ``error`` is q_d − q (rad), ``qd_cmd`` the desired joint speed (rad/s), ``felt`` the pressures,
    ``speeds`` (6, 2) the nominal joint speed at full spool in the raising and the lowering sense: K_v = k
    / speed, so the loop keeps its bandwidth over the workspace although the cylinders' levers change.
    Source: (6), (25). Valve practice, not in the paper: feed-forward of the desired speed; damping of the
    oil's spring by the load pressure behind a high pass (dynamic pressure feedback); ``pilot_share``; the
    deadband added in the direction of the command.
    """
    load = felt.load
    commands, pt1, slow, sense, furthest = np.empty(6), np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    pilot = np.empty(6)
    for i in range(6):
        proportional = gains.gain[i] * error[i]
        pt1[i] = pt1_step(filters.pt1[i], proportional, gains.time_constant[i], dt_s)
        slow[i] = pt1_step(filters.load[i], load[i], gains.high_pass, dt_s)
        demand = filters.pt1[i] if gains.time_constant[i] > 0.0 else proportional
        demand += gains.feed_forward * qd_cmd[i] - gains.damping[i] * (load[i] - filters.load[i])
        opens, pilot[i] = pilot_share(gains.holding, i, filters.pilot[i], felt, qd_cmd[i], dt_s)
        if opens != 0.0:
            demand += opens
        side = 0 if demand >= 0.0 else 1
        flow = demand / (gains.flow_gain[i, side] * speeds[i, side])
        opening = math.copysign(opening_for(gains.curve[i, side], abs(flow)), flow)
        target = opening + gains.deadband[i, side] * max(-1.0, min(1.0, opening / gains.blend[i, side]))
        spool, sense[i], furthest[i] = without_play(
            target, gains.half_play[i], filters.sense[i], filters.furthest[i]
        )
        commands[i] = max(-gains.limit, min(gains.limit, spool))
    return commands, JointFilters(pt1, slow, sense, furthest, pilot)
