"""The plant: valve commands in, sensors out, physics in between, and the truth for its own recording only."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import settled
from plant_emulator.config.actuators import BAR
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES, ValvesConfig
from plant_emulator.core import layout as col
from plant_emulator.core.camera.exposures import CameraMotion, CameraView, motion_between
from plant_emulator.core.equilibrium import rest_state
from plant_emulator.core.faults.effects import (
    MOST_KG,
    break_hydraulics,
    encoder_shift,
    joints_with,
    load_kg,
    object_shift_m,
    sensor_fault_reported,
    try_out,
)
from plant_emulator.core.faults.kinds import AnyFault, EncoderStuck, OwnFault, ValveSwapped
from plant_emulator.core.faults.schedule import FaultSchedule, Injection
from plant_emulator.core.hydraulics.valve_commands import ValveCommands, ValveDrive
from plant_emulator.core.layout import (
    DRIVEN,
    HINGES,
    N_ACTUATORS,
    PRESSURE_A,
    PRESSURE_B,
    RATE,
    SPOOL,
    SUPPLY,
    TEMPERATURE,
    Q,
)
from plant_emulator.core.mechanics.elastic import start_angles
from plant_emulator.core.mechanics.geometry import Chain, base_tilt, transform
from plant_emulator.core.mechanics.loose import set_phases
from plant_emulator.core.mechanics.multibody import forward_kinematics
from plant_emulator.core.model import Model, build_model, put_payload
from plant_emulator.core.right_hand_side import EncoderShafts, advance_commanded, new_work
from plant_emulator.core.stability import check_step
from plant_emulator.core.truth import Encoders, Mounts, PlantTruth, inverse
from protocol.errors import RequestRefused
from protocol.process_image import (
    STATUS_SENSOR_FAULT,
    STATUS_SUPPLY_ON,
    STATUS_VALVES_ENABLED,
    STATUS_WATCHDOG_TRIPPED,
    SensorImage,
    ValveImage,
)

Array = NDArray[np.float64]

_JOINT_ANGLES, _JOINT_RATES = Q + np.array(DRIVEN), RATE + np.array(DRIVEN)  # in the state
_INSTANT_S = 1e-4  # over which a velocity is a difference of poses

NOMINAL_MOUNTS = Mounts(
    X_WB=np.eye(4),
    X_TC=transform(np.eye(3), np.array([-0.20, -0.05, -0.40])),
    X_TM=transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3)),
    X_WO=transform(
        np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([4.7, 0.0, 1.0])
    ),
)


def _valve_drive(valves: ValvesConfig) -> ValveDrive:
    """Delay and hysteresis of the six valves, as ``ValveCommands`` takes them."""
    six = [valves.of(name, 1.0) for name in JOINT_NAMES]
    return ValveDrive(
        tuple(round(valve.delay_ms * 1e6) for valve in six), tuple(0.5 * valve.hysteresis for valve in six)
    )


class Plant:
    """The arm, its oil and its sensors at simulated time ``time_ns``; bit-identical for one seed.

    Starts at rest at the configured pose. The loop around it is ``write`` the valve image, ``advance``,
    ``read``.
    """

    def __init__(self, config: PlantConfig, seed: int, mounts: Mounts = NOMINAL_MOUNTS) -> None:
        self.config = config
        self.time_ns = 0
        self._step_ns = round(config.step_ms * 1e6)
        self._owed_ns = 0
        self._rng = np.random.default_rng(seed)
        self._mounts = mounts._replace(X_WB=mounts.X_WB @ base_tilt(config))
        self._model, self._chain, self._bare_tool = build_model(config)
        self._payload_kg = self._load_kg = config.payload.mass_kg
        put_payload(self._model, self._bare_tool, self._payload_kg, config, self._chain)
        set_phases(self._model.loose, seed)
        start = start_angles(config, self._chain.names)
        self._state = rest_state(self._model, start, config.oil.temperature_degc)
        check_step(self._model, self._state, config.step_ms * 1e-3, self._chain.names)
        self._work = new_work(self._model)
        self._forward = settled(forward_kinematics, start, self._model.mechanism, self._work.multibody)
        named = list(zip(self._model.places.angle, self._chain.names, strict=True))
        bending = [[angle for angle, name in named if hinge in name] for hinge in HINGES]
        self._bending = np.concatenate(bending)
        self._first_bending = np.cumsum([0, *map(len, bending[:-1])])
        self._encoders = Encoders(config.errors, self._rng)
        play = config.errors.backlash
        half_play = np.asarray(play.half_width_mrad) * 1e-3 if play.enabled else np.zeros(N_ACTUATORS)
        self._shafts = EncoderShafts(self._state[_JOINT_ANGLES].copy(), half_play)
        self._commands = ValveCommands(_valve_drive(config.valves), round(config.watchdog_ms * 1e6))
        self._advance = settled(advance_commanded, *self._advanced(0))
        self.faults = FaultSchedule()
        self._healthy = self._model.actuators.copy()
        self._half_hysteresis = self._commands.targets.half_hysteresis.copy()
        self._cycle = 0

    def write(self, image: ValveImage) -> None:
        """Take the controller's valve image; valves act while enabled and while the watchdog has not tripped.

        Raises ImageRefused when a valve command is not finite.
        """
        self._commands.write(image, self.time_ns + self._owed_ns)

    def advance(self, duration_ns: int) -> None:
        """Let ``duration_ns`` of simulated time pass; a remainder below one step is owed to the next call."""
        if duration_ns < 0:
            raise ValueError(f"duration_ns = {duration_ns}: time does not run backwards")
        self._owed_ns += duration_ns
        while self._owed_ns >= self._step_ns:
            self._events()
            until = min(self._commands.deadline_ns(), self.faults.next_ns(), self.time_ns + self._owed_ns)
            steps = min(max(self._steps_to(until), 1), self._owed_ns // self._step_ns)
            self._advance(*self._advanced(steps))
            self.time_ns += steps * self._step_ns
            self._owed_ns -= steps * self._step_ns
        self._events()
        self._cycle = (self._cycle + 1) & 0xFFFFFFFF

    def _advanced(self, steps: int) -> tuple[Any, ...]:
        """What ``advance_commanded`` takes for the next ``steps``."""
        drive, leaving = self._commands.targets, self._leaving(steps)
        step_s = self._step_ns * 1e-9
        return self._state, drive, leaving, self._shafts, steps, step_s, self._model, self._work

    def _steps_to(self, time_ns: int) -> int:
        """How many steps lead to ``time_ns`` or just beyond."""
        return -(-(time_ns - self.time_ns) // self._step_ns)

    def _leaving(self, steps: int) -> Array:
        """What leaves the drives within the next ``steps``, as ``advance_commanded`` takes it."""
        last_ns = self.time_ns + (steps - 1) * self._step_ns
        rows = [(self._steps_to(due_ns), *what) for due_ns, *what in self._commands.leaving(last_ns)]
        return np.array(rows, dtype=np.float64).reshape(-1, 3)

    def read(self) -> SensorImage:
        """The sensors at this instant, as the fieldbus carries them."""
        pressures = self._state[PRESSURE_A : PRESSURE_B + N_ACTUATORS].reshape(2, N_ACTUATORS) / BAR
        a, b, c, d, e, f = self._encoders.read(
            self._shafts.angle, encoder_shift(self.faults.active, self.time_ns)
        )
        return SensorImage(
            plant_cycle=self._cycle,
            echo_cycle=self.echo_cycle,
            status=self.status,
            encoder_counts=(a, b, c, d, e, f),
            pressures_bar=tuple(zip(*pressures.tolist(), strict=True)),
            supply_bar=float(self._state[SUPPLY]) / BAR,
            return_bar=float(self._model.circuit[col.C_RETURN]) / BAR,
            oil_temperature_degc=float(self._state[TEMPERATURE]),
        )

    @property
    def model(self) -> Model:
        """The tables that the compiled code reads."""
        return self._model

    @property
    def echo_cycle(self) -> int:
        """The cycle counter of the newest valve image; 0 before the first."""
        return self._commands.echo_cycle

    @property
    def status(self) -> int:
        """The status word at this instant."""
        return (
            (STATUS_SUPPLY_ON if self._model.circuit[col.C_RUNNING] > 0.0 else 0)
            | (STATUS_VALVES_ENABLED if self._commands.enabled else 0)
            | (STATUS_WATCHDOG_TRIPPED if self._commands.tripped else 0)
            | (STATUS_SENSOR_FAULT if sensor_fault_reported(self.faults.in_force()) else 0)
        )

    def truth(self) -> PlantTruth:
        """Where everything really is now; for the plant's own recording, never for another service."""
        work, state, mounts = self._work, self._state, self._mounts
        X_WB, X_BT, X_WT = self._poses(state[self._model.places.angle])
        X_WC, X_WM = X_WT @ mounts.X_TC, X_WT @ mounts.X_TM
        X_CW = inverse(X_WC)
        X_WO = mounts.X_WO @ transform(np.eye(3), object_shift_m(self.faults.active, self.time_ns))
        X_CM, X_CO = X_CW @ X_WM, X_CW @ X_WO
        return PlantTruth(
            time_ns=self.time_ns,
            q=state[_JOINT_ANGLES],
            q_rate=state[_JOINT_RATES],
            deflections=np.add.reduceat(state[self._bending], self._first_bending),
            X_BT=X_BT,
            X_WB=X_WB,
            X_WT=X_WT,
            X_WC=X_WC,
            X_WM=X_WM,
            X_WO=X_WO,
            p_CM=X_CM[:3, 3],
            p_CO=X_CO[:3, 3],
            R_CM=X_CM[:3, :3],
            R_CO=X_CO[:3, :3],
            pressures=state[PRESSURE_A : PRESSURE_B + N_ACTUATORS].reshape(2, N_ACTUATORS).T.copy(),
            supply=float(state[SUPPLY]),
            oil_temperature_degc=float(state[TEMPERATURE]),
            payload_kg=self._load_kg,
            valves=self._commands.targets.commanded.copy(),
            spools=state[SPOOL : SPOOL + N_ACTUATORS].copy(),
            flows=work.flows[:, [col.F_NET_A, col.F_NET_B]].copy(),
            faults=tuple(sorted(fault.name for fault in self.faults.in_force())),
        )

    @property
    def chain(self) -> Chain:
        """The arm's joints and hinges, base first, at home."""
        return self._chain

    def links(self) -> Array:
        """Poses (n, 4, 4) in the world of the chain's bodies, each at its own joint, as parallel to the base
        at home; for drawings.
        """
        where, chain = self._model.places, self._chain
        self._poses(self._state[where.angle])
        work = self._work.multibody
        X_WL = np.broadcast_to(np.eye(4), (len(chain.names), 4, 4)).copy()
        X_WL[:, :3, :3] = work.rotation[1:]
        X_WL[:, :3, 3] = np.einsum("nij,nj->ni", work.rotation[1:], chain.point) + work.origin[1:]
        return np.asarray(self._mounts.X_WB @ X_WL)

    def motion(self) -> CameraMotion:
        """How camera and tool marker move now, for pictures of finite exposure."""
        where = self._model.places
        q, rate = self._state[where.angle], self._state[where.rate]
        views = []
        for offset_s in (-0.5 * _INSTANT_S, 0.5 * _INSTANT_S):
            X_WT = self._poses(q + offset_s * rate)[2]
            views.append(CameraView(X_WT @ self._mounts.X_TC, X_WT @ self._mounts.X_TM))
        return motion_between(views[0], views[1], _INSTANT_S)

    def _poses(self, q: Array) -> tuple[Array, Array, Array]:
        """X_WB, X_BT and X_WT (4, 4) at angles ``q`` (n,) of the chain; a base that rocks is where it is."""
        self._forward(q, self._model.mechanism, self._work.multibody)
        work, X_WB = self._work.multibody, self._mounts.X_WB
        rotation, origin = work.rotation, work.origin
        X_BT = transform(rotation[-1], origin[-1]) @ self._chain.X_BT_home
        X_WT = X_WB @ X_BT
        if self._chain.names[0] == "slew":
            return X_WB, X_BT, X_WT
        k = self._chain.names.index("slew")  # the body before it is the base
        rocked = transform(rotation[k], origin[k])
        return X_WB @ rocked, inverse(rocked) @ X_BT, X_WT

    def set_payload(self, mass_kg: float) -> None:
        """Change the load at the tool at this instant; velocities stay, as when a load is let go.

        Raises RequestRefused outside 0 to 1000 kg.
        """
        if not 0.0 <= mass_kg <= MOST_KG:
            raise RequestRefused("refused.payload", f"payload {mass_kg:g} kg, wanted 0 to {MOST_KG:g}")
        self._payload_kg = mass_kg
        self._apply_faults()

    def inject(
        self, fault: AnyFault, start_ns: int | None = None, duration_ns: int | None = None
    ) -> Injection:
        """Break something from simulated time ``start_ns`` on (None: now), for ``duration_ns`` or for good.

        What concerns camera and coupler is kept here too, for those who play them to ask. Raises
        RequestRefused as FaultSchedule.inject does, and ``refused.disturbance`` for one of your own
        whose effects are nothing that a plant takes.
        """
        if isinstance(fault, OwnFault):
            try_out(fault)
        injection = self.faults.inject(fault, self.time_ns, start_ns, duration_ns)
        self._settle_faults()
        return injection

    def clear(self, number: int | None = None) -> list[Injection]:
        """Mend the fault of this number, or everything (None), and forget what of it was planned.

        Returns what was mended. Raises RequestRefused when there is none of this number.
        """
        mended = self.faults.clear(number, self.time_ns)
        self._apply_faults()
        return mended

    def _settle_faults(self) -> None:
        if self.faults.settle(self.time_ns):
            self._apply_faults()

    def _apply_faults(self) -> None:
        """Bring everything that faults change to what those in force make of it."""
        active, now_ns = self.faults.active, self.time_ns
        self._load_kg = load_kg(active, now_ns, self._payload_kg)
        self._commands.swap(joints_with(ValveSwapped, self.faults.in_force()))
        wider = break_hydraulics(active, now_ns, self._model, self._healthy, self._state)
        self._commands.targets.half_hysteresis[:] = wider * self._half_hysteresis
        self._encoders.hold(joints_with(EncoderStuck, self.faults.in_force()), self._shafts.angle)
        put_payload(self._model, self._bare_tool, self._load_kg, self.config, self._chain)

    def _events(self) -> None:
        """Let what is due by now happen: faults, the watchdog, commands that leave the delay."""
        self._settle_faults()
        self._commands.settle(self.time_ns)
