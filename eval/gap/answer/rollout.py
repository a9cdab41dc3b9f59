"""Open-loop simulation from measured states: the prediction error in metres, in both plants.

A window starts at the smoothed measured state (the thrust lag from the commands before it, the loops'
integrals as predicted along the flight) and is driven by the commands alone, attitude included. Delayed
commands are averaged exactly over each step.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator, Sequence

import numba
import numpy as np
import scipy  # whose submodules are imported when they are used

from inclined_landing.eval.gap.measured.windows import (
    SMOOTHING,
    MeasuredFlight,
    earlier,
    prepare,
    remove_tilt,
)
from inclined_landing.eval.gap.model.prediction import (
    angle_integrals,
    as_flown,
    delayed_commands,
    predict,
    without_delays,
)
from inclined_landing.eval.gap.result import HORIZON
from inclined_landing.eval.logs import FlightLog
from inclined_landing.eval.logs.log import as_logs
from inclined_landing.models import equations, forces
from inclined_landing.models.attitude import (
    LAG,
    PITCH,
    ROLL,
    STATE_SIZE,
    VX,
    WX,
    WY,
    WZ,
    YAW,
    X,
    Y,
    Z,
    body_rates,
    tilted,
)
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.load import UNLOADED, hanging
from inclined_landing.models.parameters import as_vehicle
from inclined_landing.models.vehicle import Vehicle

EVERY = 1.0  # s between the starts of two windows
LARGEST_STEP = 0.004  # s at most
CLEAR_HEIGHT = 50.0  # m, at which no surface is near
POSITION, TILT, HEADING = range(3)  # of `pose_errors`
_POSE = [X, Y, Z, ROLL, PITCH, YAW]  # of a state
ANGLE_SMOOTHING = 0.05  # s to either side, for start attitudes and their rates


@dataclasses.dataclass
class RolloutWindows:
    """Windows of several flights to simulate together; all have the same number of rows."""

    flights: list[MeasuredFlight]
    flight_of: np.ndarray  # (n,)
    first: np.ndarray  # (n,) row in the flight
    rows: int  # steps of the horizon
    dt: float
    # Poses that were simulated already, by plant and vehicle.
    _poses: dict[tuple[str, Vehicle], np.ndarray] = dataclasses.field(default_factory=dict, repr=False)

    @staticmethod
    def of(flights: Sequence[MeasuredFlight], horizon: float = HORIZON) -> RolloutWindows:
        """Return a window every EVERY seconds wherever all of it is usable.

        Raises UserError when the flights have different rates, and where no stretch is long enough.
        """
        dt = flights[0].dt
        if any(abs(f.dt - dt) > 0.02 * dt for f in flights):
            raise UserError("flights logged at different rates cannot be simulated together")
        rows, stride, margin = round(horizon / dt), max(1, round(EVERY / dt)), max(2, round(SMOOTHING / dt))
        first = []  # of every flight
        for f in flights:
            before = np.arange(0, f.samples - rows - 1 - margin, stride)
            first.append(margin + f.usable_from(before, margin + rows + 1))
        if not any(map(len, first)):
            names = ", ".join(f.name for f in flights)
            raise UserError(f"{names}: no {horizon:g} s of uninterrupted free flight")
        flight_of = np.repeat(np.arange(len(flights)), [*map(len, first)])
        return RolloutWindows(list(flights), flight_of, np.concatenate(first), rows, dt)

    def __len__(self) -> int:
        return len(self.first)

    def by_flight(self, vehicles: Sequence[Vehicle]) -> Iterator[tuple[RolloutWindows, Vehicle]]:
        """Yield the windows of every flight that has some, with its vehicle."""
        for k, vehicle in enumerate(vehicles):
            own = self.flight_of == k
            if own.any():
                none = np.zeros(int(own.sum()), int)
                yield RolloutWindows([self.flights[k]], none, self.first[own], self.rows, self.dt), vehicle

    def gather(self, values: Sequence[np.ndarray], rows: int | None = None) -> np.ndarray:
        """Return the rows (n, rows, ...) of every window from one array for each flight."""
        rows = self.rows if rows is None else rows
        return np.stack([values[f][a : a + rows] for f, a in zip(self.flight_of, self.first)])

    def measured(self) -> np.ndarray:
        """Return the measured pose (n, rows + 1, 6)."""
        return self.gather([f.pose for f in self.flights], self.rows + 1)


def _filter_lengths(dt: float) -> tuple[int, int]:
    """Return the rows of the smoothing filters of position and of attitude."""
    wide, narrow = (2 * max(2, round(x / dt)) + 1 for x in (SMOOTHING, ANGLE_SMOOTHING))
    return wide, narrow


def smoothed_states(flight: MeasuredFlight, vehicle: Vehicle) -> np.ndarray:
    """Return the states (m, 13) from smoothed measurements (Savitzky-Golay, second order); lag zero.

    A delay of the vehicle's measured attitude beyond that of the position is taken off.
    """
    state = _smoothed_states(flight)
    if late := vehicle.effects_estimator_delay:
        state = state.copy()
        state[:, ROLL:LAG] = earlier(state[:, ROLL:LAG], -late / flight.dt)
    return state


@functools.lru_cache(maxsize=64)  # the same for every vehicle
def _smoothed_states(flight: MeasuredFlight) -> np.ndarray:
    """Return `smoothed_states` before the vehicle's delay is taken off."""
    dt = flight.dt
    wide, narrow = _filter_lengths(dt)
    state = np.zeros((flight.samples, STATE_SIZE))
    state[:, :3] = scipy.signal.savgol_filter(flight.position, wide, 2, axis=0)
    state[:, VX : VX + 3] = flight.velocity
    state[:, ROLL : ROLL + 3] = scipy.signal.savgol_filter(flight.attitude, narrow, 2, axis=0)
    rates = scipy.signal.savgol_filter(flight.attitude, narrow, 2, 1, dt, axis=0)
    _turning(state, rates)
    return state


@numba.njit(cache=True)
def _turning(state, rates):
    """Write the body rates of Euler rates (m, 3) into states (m, 13)."""
    for k in range(len(state)):
        state[k, WX], state[k, WY], state[k, WZ] = body_rates(
            state[k, ROLL], state[k, PITCH], rates[k, 0], rates[k, 1], rates[k, 2]
        )


def start_state_noise(flight: MeasuredFlight) -> np.ndarray:
    """Return the standard deviations (12,) of a smoothed state: position, velocity, attitude, rates."""
    # White noise sigma through the filter coefficients c:  sigma |c|
    dt = flight.dt
    wide, narrow = _filter_lengths(dt)
    factor = [
        np.linalg.norm(scipy.signal.savgol_coeffs(n, 2, d, dt))
        for n, d in ((wide, 0), (wide, 1), (narrow, 0), (narrow, 1))
    ]
    p, a = flight.noise[:3], flight.noise[3:6]
    return np.concatenate([factor[0] * p, factor[1] * p, factor[2] * a, factor[3] * a])


def simulate(
    starts: RolloutWindows, vehicle: Vehicle, plant: str = "analytic", perturbation: np.ndarray | None = None
) -> np.ndarray:
    """Return the simulated pose (n, rows + 1, 6) of every window.

    Flights without attitude commands follow the measured attitude, by the equations in either plant.
    perturbation: (n, 12) added to position, velocity, attitude and body rates of the start states.
    """
    key = plant, vehicle
    if perturbation is None and key in starts._poses:
        return starts._poses[key]
    vehicle = as_flown(starts.flights[0], vehicle)
    driven = [delayed_commands(f.command, f.dt, vehicle) for f in starts.flights]
    commands = starts.gather([c for c, _ in driven])
    state = starts.gather([smoothed_states(f, vehicle) for f in starts.flights], 1)[:, 0]
    tilt, late = vehicle.effects_mocap_tilt, vehicle.effects_estimator_delay
    if any(tilt):
        state[:, ROLL : ROLL + 3] = remove_tilt(state[:, ROLL : ROLL + 3].copy(), tilt)
    lag = starts.gather([lag for _, lag in driven])
    state[:, LAG] = lag[:, 0]
    if perturbation is not None:
        state[:, :LAG] += perturbation
    ambient = starts.gather([f.ambient for f in starts.flights])
    integral = starts.gather([angle_integrals(f, vehicle) for f in starts.flights], 1)[:, 0]
    if plant == "analytic":
        pose = _analytic(starts, vehicle, state, integral, commands, ambient)
    else:
        from inclined_landing.models.plants import check_plant  # here, as most predictions need no engine

        check_plant(plant)
        pose = _mujoco(starts, vehicle, state, integral, commands, ambient, lag)
    if late:
        pose[:, :, 3:] = earlier(pose[:, :, 3:], late / starts.dt)
    if any(tilt):
        for window in pose:
            tilted(window[:, 3:].copy(), *tilt, window[:, 3:])
    without_commands = [k for k, f in enumerate(starts.flights) if not f.has_angle_commands]
    driven_by_attitude = np.isin(starts.flight_of, without_commands)
    if driven_by_attitude.any():
        pose[driven_by_attitude, :, :3] = along_measured_attitude(starts, vehicle)[driven_by_attitude]
        pose[driven_by_attitude, :, 3:] = starts.measured()[driven_by_attitude, :, 3:]
    if perturbation is None:
        starts._poses[key] = pose
    return pose


def _analytic(starts, vehicle, state, integral, commands, ambient) -> np.ndarray:
    """Return the poses simulated by the equations."""
    n = len(starts)
    pose = np.empty((n, starts.rows + 1, 6))
    pose[:, 0] = state[:, _POSE]
    substeps = max(1, math.ceil(starts.dt / LARGEST_STEP))
    step_ambient = ambient[:, 0].copy()
    step_ambient[:, forces.TIME] -= 0.5 * starts.dt
    load = hanging(n) if vehicle.effects_load_mass else UNLOADED
    conditions = equations.Conditions(
        forces.pack(vehicle), np.ones(n), step_ambient, load=load, integral=integral
    )
    for k in range(starts.rows):
        step_ambient[:, 1:] = ambient[:, k, 1:]
        command, dt = np.ascontiguousarray(commands[:, k]), starts.dt / substeps
        equations.advance(state, command, conditions, True, dt, substeps)
        pose[:, k + 1] = state[:, _POSE]
    return pose


def _mujoco(starts, vehicle, state, integral, commands, ambient, lag) -> np.ndarray:
    """Return the poses simulated in MuJoCo; effects of flight time and voltage enter as a thrust scale."""
    from inclined_landing.models.plants import MujocoPlant

    n = len(starts)
    plain = dataclasses.replace(
        without_delays(vehicle), effects_thrust_fade=0.0, effects_voltage_sensitivity=0.0
    )
    scale = _thrust_scales(ambient, lag, forces.pack(vehicle))
    varies = bool((scale != 1.0).any())
    step = starts.dt / math.ceil(starts.dt / LARGEST_STEP - 1e-9)
    # Free flight meets nothing: without surfaces that matter it is flown high above the floor.
    slab = ambient[:, 0, forces.PRESENT] > 0.0
    lift = 0.0 if vehicle.effects_ground_effect or slab.any() else CLEAR_HEIGHT
    plant = MujocoPlant(n, plain, control_period=starts.dt, timestep=step, contacts=not lift)
    plant.set_platform(np.arange(n), vehicle.platform_inclination, slab)
    state[:, 2] += lift
    plant.reset(np.arange(n), state)
    plant.integral[:] = integral
    pose = np.empty((n, starts.rows + 1, 6))
    pose[:, 0] = state[:, _POSE]
    for k in range(starts.rows):
        if varies:
            plant.set_thrust_scale(scale[:, k])
        plant.step(commands[:, k])
        pose[:, k + 1] = plant.state[:, _POSE]
    pose[:, :, 2] -= lift
    return pose


@numba.njit(cache=True)
def _thrust_scales(ambient, lag, vehicle):
    """Return the thrust scale (n, rows) by flight time and battery voltage."""
    v, out = vehicle[0], np.empty(lag.shape)
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            time, voltage = ambient[i, k, forces.TIME], ambient[i, k, forces.VOLTAGE]
            out[i, k] = forces.fade(time, v) * forces.supply(voltage, lag[i, k], time, v)
    return out


def position_error(simulated: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return the root mean square distance (rows,) [m] over windows, after every step."""
    return np.sqrt(((simulated[..., :3] - measured[..., :3])[:, 1:] ** 2).sum(axis=2).mean(axis=0))


def noise_floor(starts: RolloutWindows, vehicle: Vehicle) -> np.ndarray:
    """Return the error (rows,) [m] of a perfect model: noise of the start state and of the measurement.

    It is the difference of two simulations of `vehicle`, from start states with and without the noise that
    smoothing leaves, and the noise of the measurement at the end.
    """
    rng = np.random.default_rng(0)
    scale = np.stack([start_state_noise(f) for f in starts.flights])[starts.flight_of]
    a = simulate(starts, vehicle)
    b = simulate(starts, vehicle, perturbation=scale * rng.standard_normal(scale.shape))
    end = np.stack([f.noise[:3] for f in starts.flights])[starts.flight_of]
    return np.sqrt(position_error(a, b) ** 2 + (end**2).sum(axis=1).mean())


def along_measured_attitude(starts: RolloutWindows, vehicle: Vehicle) -> np.ndarray:
    """Return the positions (n, rows + 1, 3) of every window, driven by the measured attitude.

    Axes along which the motion cannot be predicted are as measured.
    """
    moved = np.empty((len(starts), starts.rows + 1, 3))
    time = np.arange(starts.rows + 1) * starts.dt
    for k, flight in enumerate(starts.flights):
        own = np.flatnonzero(starts.flight_of == k)
        if not len(own):
            continue
        predicted = predict(flight, vehicle)[:, :3]
        start = smoothed_states(flight, vehicle)
        rate = np.gradient(predicted, flight.dt, axis=0)
        for i in own:
            a = starts.first[i]
            line = start[a, :3] + time[:, None] * (start[a, VX : VX + 3] - rate[a])
            moved[i] = predicted[a : a + 1 + starts.rows] - predicted[a] + line
            unknown = ~flight.logged[:3]
            moved[i][:, unknown] = flight.position[a : a + 1 + starts.rows, unknown]
    return moved


def errors_by_flight(
    starts: RolloutWindows, vehicle: Vehicle | Sequence[Vehicle], plant: str = "analytic"
) -> np.ndarray:
    """Return `position_error` (rows,); each flight may have its own vehicle."""
    vehicles = [vehicle] if isinstance(vehicle, Vehicle) else vehicle
    if len(set(vehicles)) == 1:
        return position_error(simulate(starts, vehicles[0], plant), starts.measured())
    squares, total = 0.0, 0
    for part, own in starts.by_flight(vehicles):
        squares = squares + len(part) * position_error(simulate(part, own, plant), part.measured()) ** 2
        total += len(part)
    return np.sqrt(squares / total)


def pose_errors(starts: RolloutWindows, vehicles: Sequence[Vehicle]) -> np.ndarray:
    """Return the errors (3,) at the end, with a vehicle a flight: POSITION [m], TILT and HEADING [rad]."""
    # (n, 6) of every flight
    errors = [(simulate(part, own) - part.measured())[:, -1] for part, own in starts.by_flight(vehicles)]
    squares = (np.concatenate(errors) ** 2).mean(axis=0)  # of x, y, z, roll, pitch, yaw
    return np.sqrt([squares[:3].sum(), squares[3:5].sum(), squares[5]])


def measure_gap(
    vehicle: Vehicle,
    flights: Sequence[FlightLog],
    horizon: float = HORIZON,
    plant: str = "analytic",
    *,
    platform=False,
) -> dict:
    """Return the open-loop position error of a vehicle on measured flights.

    {error, floor, windows, horizon}: root mean square distance [m] after `horizon` seconds, that of noise
    alone, and the number of windows.
    Raises UserError when no flight has a usable stretch of that length.
    """
    vehicle = as_vehicle(vehicle)
    logs = as_logs(flights)
    if not logs:
        raise UserError("no flight given")
    starts = RolloutWindows.of([prepare(log, vehicle, platform=platform) for log in logs], horizon)
    error = errors_by_flight(starts, vehicle, plant)
    floor = noise_floor(starts, vehicle)
    return {
        "error": float(error[-1]),
        "floor": float(floor[-1]),
        "windows": len(starts),
        "horizon": starts.rows * starts.dt,
    }
