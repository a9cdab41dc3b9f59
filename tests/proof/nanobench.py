"""`nanobench`: the identification task of NanoBench, by its own definitions.

Ullah and Baca, arXiv:2603.09908 (2026), section III-E and table V: from a measured state a model predicts 50
steps of 10 ms, open loop; the errors of position, velocity and angular velocity are Euclidean distances, that
of attitude the angle of the rotation between; MAE(h) is their mean over all starts, MAE(1:50) the sum over
the steps. The code of that task and its list of test flights are not in the published repository.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numba
import numpy as np
from msgspec import Meta
from scipy.spatial.transform import Rotation

from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.tables import new_table, say, show_table
from inclined_landing.eval.base.options import Flag, LogFiles, NewFolder, VehicleFile
from inclined_landing.eval.gap.flights.windows import prepare_all, remove_tilt
from inclined_landing.eval.gap.search import rollout
from inclined_landing.eval.logs import read_log
from inclined_landing.eval.logs.csv_file import read_columns
from inclined_landing.models import equations, forces
from inclined_landing.models.attitude import LAG, PWM, ROLL, VX, WX, rotations, tilted
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.perturbation import NEUTRAL, neutral
from inclined_landing.models.vehicle import Vehicle

HORIZON = 0.5  # s: 50 steps of 10 ms
STEPS = (1, 10, 50)
STATES = ("position m", "velocity m/s", "attitude rad", "angular velocity rad/s")
# Table V of the paper: MAE of each state after 1, 10 and 50 steps, and their sum over all steps.
PUBLISHED = {
    "naive": (
        (0.0057, 0.0585, 0.2866, 7.3866),
        (0.0085, 0.0786, 0.3542, 9.4178),
        (0.0033, 0.0285, 0.0915, 2.7563),
        (0.0402, 0.2602, 0.4524, 17.1131),
    ),
    "physics": (
        (0.0003, 0.0265, 0.6364, 10.9641),
        (0.0511, 0.5085, 2.5673, 65.0322),
        (0.0019, 0.0198, 0.1425, 3.2693),
        (0.0402, 0.2602, 0.4524, 17.1131),
    ),
    "residual": (
        (0.0045, 0.0445, 0.2282, 5.6810),
        (0.0121, 0.1096, 0.6708, 16.9002),
        (0.0084, 0.1051, 0.1971, 8.8737),
        (0.2043, 1.1173, 1.3046, 54.1783),
    ),
    "physics + residual": (
        (0.0036, 0.0121, 0.2621, 4.4071),
        (0.0201, 0.1370, 1.0771, 26.7469),
        (0.0065, 0.1359, 0.1825, 9.8645),
        (0.8784, 1.5799, 1.1781, 55.3050),
    ),
    "LSTM": (
        (0.0058, 0.0332, 0.2562, 5.9194),
        (0.0199, 0.1077, 0.4782, 11.9639),
        (0.0162, 0.1339, 0.3059, 9.8302),
        (0.1256, 0.8159, 5.1525, 118.0662),
    ),
}
_MOTORS = Path(__file__).parent / "gap_real" / "nanobench_motors.toml"
_RATES = ("imu_wx", "imu_wy", "imu_wz")


def command(
    files: LogFiles,
    /,
    vehicle: VehicleFile = None,
    motors: VehicleFile = None,
    every: Annotated[float, Meta(ge=0.01, le=10.0)] = 0.1,
    json: Flag = False,
    out: NewFolder = None,
) -> None:
    """NanoBench's identification task: an identified vehicle beside the published baselines.

    Args:
        files: flights from `landing-eval flights nanobench` that the vehicle was not fitted to.
        vehicle: vehicle file driven by thrust command and angle setpoints.
        motors: vehicle file for tests/proof/gap_real/nanobench_motors.toml, driven by the PWM of the motors
            alone; the measured angular velocity is held, as in the paper's physics model.
        every: seconds from one start to the next.
        json: print JSON, and nothing else, on standard output.
        out: new folder for nanobench.json.
    """
    if not files:
        raise UserError("name at least one flight; landing-eval flights nanobench says where they are")
    if out is not None:
        runs.check_new_run(out)
    models = {key: load_vehicle(file) for key, file in (("commands", vehicle), ("motors", motors)) if file}
    flown = Flown.of(files, None, every)
    rows = {"naive": flown.errors(naive(flown))}
    if "commands" in models:
        rows["commands"] = flown.errors(by_commands(flown, models["commands"]))
    if "motors" in models:
        spun = Flown.of(files, str(_MOTORS), every)
        rows["motors"] = spun.errors(by_motors(spun, models["motors"]))
    report = {
        "command": "nanobench",
        "flights": [Path(flight.name).name for flight in flown.starts.flights],
        "starts": len(flown.starts),
        "every": every,
        "states": STATES,
        "steps": [*map(str, STEPS), "1:50"],
        "published": PUBLISHED,
        "here": rows,
        "run": runs.versions(),
    }
    runs.hand_over(report, _show, json, out)


@dataclasses.dataclass
class Motion:
    """Of n starts, after `steps` steps each: what is measured or predicted."""

    position: np.ndarray  # (n, steps, 3) m
    velocity: np.ndarray  # (n, steps, 3) m/s
    rotation: np.ndarray  # (n, steps, 3, 3)
    rates: np.ndarray  # (n, steps, 3) rad/s, body frame


@dataclasses.dataclass
class Flown:
    """Starts in free flight, and what was measured from there on; row 0 is the start itself."""

    starts: rollout.RolloutWindows
    measured: Motion
    attitude: np.ndarray  # (n, 3) roll, pitch, yaw at the start

    @staticmethod
    def of(files: Sequence[str], mapping: str | None, every: float) -> Flown:
        """Starts in free flight, `every` seconds apart. Raises UserError where columns are missing."""
        logs = [read_log(file, mapping=mapping, name=file) for file in files]
        flights = prepare_all(logs, load_vehicle(), False, [])
        starts = rollout.RolloutWindows.of(flights, HORIZON, every)
        rates = [_rates(Path(flight.name), flight.t) for flight in flights]
        rows = starts.rows + 1
        attitude = starts.gather([f.attitude for f in flights], rows)
        measured = Motion(
            starts.gather([f.position for f in flights], rows),
            starts.gather([f.velocity for f in flights], rows),
            rotations(attitude.reshape(-1, 3)).reshape(*attitude.shape, 3),
            starts.gather(rates, rows),
        )
        return Flown(starts, measured, attitude[:, 0])

    def errors(self, predicted: Motion) -> list[list[float]]:
        """Mean absolute errors: a row for every one of STATES, with STEPS and the sum over all steps."""
        m = self.measured
        turned = np.linalg.norm(predicted.rotation - m.rotation[:, 1:], axis=(2, 3))
        distances = (
            np.linalg.norm(predicted.position - m.position[:, 1:], axis=2),
            np.linalg.norm(predicted.velocity - m.velocity[:, 1:], axis=2),
            2.0 * np.arcsin(np.minimum(turned / np.sqrt(8.0), 1.0)),
            np.linalg.norm(predicted.rates - m.rates[:, 1:], axis=2),
        )
        means = [distance.mean(axis=0) for distance in distances]
        return [[*(float(mean[h - 1]) for h in STEPS), float(mean.sum())] for mean in means]


def _rates(path: Path, t: np.ndarray) -> np.ndarray:
    """Angular velocity (m, 3) [rad/s] of the gyroscopes at the times t (m,) of the prepared flight."""
    table = read_columns(path, ("t", *_RATES))
    own = (table["t"] - table["t"].iloc[0]).to_numpy()
    if abs(own[-1] - t[-1]) > 0.02:
        raise UserError(f"{path}: rows without pose at its ends; cut them off")
    return np.stack([np.interp(t, own, table[name]) for name in _RATES], axis=1)


def naive(flown: Flown) -> Motion:
    """Nothing changes."""
    m, steps = flown.measured, flown.starts.rows
    return Motion(*(np.repeat(x[:, :1], steps, axis=1) for x in dataclasses.astuple(m)))


def by_commands(flown: Flown, vehicle: Vehicle) -> Motion:
    """The vehicle's own prediction from thrust command and angle setpoints, in the paper's equations."""
    starts, m = flown.starts, flown.measured
    n, steps = len(starts), starts.rows
    driven = [rollout.delayed_commands(f.command, f.dt, vehicle) for f in starts.flights]
    commands = starts.gather([c for c, _ in driven])
    state = np.zeros((n, LAG + 1))
    state[:, :3], state[:, VX : VX + 3] = m.position[:, 0], m.velocity[:, 0]
    state[:, ROLL : ROLL + 3], state[:, WX : WX + 3] = flown.attitude, m.rates[:, 0]
    tilt = vehicle.effects_mocap_tilt
    if any(tilt):
        state[:, ROLL : ROLL + 3] = remove_tilt(state[:, ROLL : ROLL + 3].copy(), tilt)
    state[:, LAG] = starts.gather([lag for _, lag in driven], 1)[:, 0]
    ambient = starts.gather([f.ambient for f in starts.flights])
    around = ambient[:, 0].copy()
    conditions = equations.Conditions(forces.pack(vehicle), neutral(n), around)
    found = np.empty((n, steps, LAG))
    for k in range(steps):
        around[:, 1:] = ambient[:, k, 1:]
        now = np.ascontiguousarray(commands[:, k])
        equations.advance(state, now, conditions, True, starts.dt, 1)
        found[:, k] = state[:, :LAG]
    attitude = found[..., ROLL : ROLL + 3].reshape(-1, 3).copy()
    if any(tilt):
        tilted(attitude.copy(), *tilt, attitude)
    turned = rotations(attitude).reshape(n, steps, 3, 3)
    return Motion(found[..., :3], found[..., VX : VX + 3], turned, found[..., WX : WX + 3])


def by_motors(flown: Flown, vehicle: Vehicle) -> Motion:
    """Position and velocity under the PWM of the motors while the measured angular velocity is held."""
    starts, m = flown.starts, flown.measured
    n, steps, dt = len(starts), starts.rows, starts.dt
    driven = [rollout.delayed_commands(f.command, f.dt, vehicle) for f in starts.flights]
    pwm = starts.gather([c[:, PWM] for c, _ in driven])
    lag = starts.gather([lag for _, lag in driven], 1)[:, 0]
    ambient = starts.gather([f.ambient for f in starts.flights])
    out = Motion(*(np.empty((n, steps, *x.shape[2:])) for x in dataclasses.astuple(m)))
    out.rates[:] = m.rates[:, :1]
    half = Rotation.from_rotvec(0.5 * dt * m.rates[:, 0]).as_matrix()
    tilt = np.eye(3)
    if any(vehicle.effects_mocap_tilt):
        tilt = rotations(np.array([[*vehicle.effects_mocap_tilt, 0.0]]))[0].T
    turned = m.rotation[:, 0]
    middle = np.empty((n, steps, 3, 3))
    for k in range(steps):
        middle[:, k] = turned @ half @ tilt
        turned = turned @ half @ half
        out.rotation[:, k] = turned
    start = m.position[:, 0], m.velocity[:, 0]
    _pushed(*start, middle, pwm, lag, ambient, forces.pack(vehicle), dt, out.position, out.velocity)
    return out


@numba.njit(cache=True)
def _pushed(position, velocity, rotation, pwm, lag, ambient, vehicle, dt, moved, speed):
    """Position and velocity (n, steps, 3) after every step with given rotation (n, steps, 3, 3) and PWM."""
    v, f = vehicle[0], np.zeros(5)
    none = np.array(NEUTRAL)
    for i in range(pwm.shape[0]):
        x, u, state = position[i].copy(), velocity[i].copy(), lag[i]
        for k in range(pwm.shape[1]):
            state, mean = forces.lag_step(state, pwm[i, k], dt, v)
            r = rotation[i, k]
            forces.wrench(x, u, r, mean, pwm[i, k], ambient[i, k], v, none, f)
            for j in range(3):
                a = (r[j, 0] * f[0] + r[j, 1] * f[1] + r[j, 2] * f[2]) / v.body.mass
                if j == 2:
                    a -= v.environment.gravity
                x[j] += dt * (u[j] + 0.5 * dt * a)
                u[j] += dt * a
                moved[i, k, j], speed[i, k, j] = x[j], u[j]


def _show(report: dict) -> None:
    names = {"naive": "naive, here", "commands": "ours, by commands", "motors": "ours, by motors"}
    rows = {f"{key}, published": value for key, value in PUBLISHED.items()}
    rows |= {names[key]: value for key, value in report["here"].items()}
    for k, state in enumerate(STATES):
        table = new_table(f"mean absolute error of {state}", "model", *(f"h = {h}" for h in report["steps"]))
        for name, row in rows.items():
            table.add_row(name, *(f"{x:.4f}" for x in row[k]))
        show_table(table)
    errors = ", ".join(f"{names[key]} {row[0][-1]:.4f}" for key, row in report["here"].items())
    counts = f"{report['starts']} starts in {len(report['flights'])} flights"
    say(f"{counts}; mean absolute error of {STATES[0]} at h = {report['steps'][-1]}: {errors}.")
