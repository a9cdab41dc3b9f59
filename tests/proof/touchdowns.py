"""`touchdowns`: measured touchdowns on a flat floor (NanoBench flights), and the same ones simulated.

A touchdown is where a descending vehicle with running motors turns upwards near the floor. From the
measured position, velocity and attitude 60 ms before it, under the measured motor PWM and attitude
commands, the MuJoCo vehicle flies on; restitution and contact time are fitted to the measured height.
The thrust is taken relative to the flight's own hover, because mass and motors of the vehicle are unknown.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import tyro
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from inclined_landing.envs.shared import runs
from inclined_landing.eval.base.options import Folder
from inclined_landing.models import contact, storage
from inclined_landing.models.attitude import LAG, PITCH, ROLL, STATE_SIZE, VX, VY, VZ, WX, WY, WZ, YAW, Z
from inclined_landing.models.errors import UserError
from inclined_landing.models.geometry import reach_below
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import fly
from inclined_landing.models.vehicle import Vehicle
from tests.proof.columns import read_columns
from tests.proof.shared import table_of

PERIOD = 0.01  # s, of the measurements
BEFORE, AFTER = 0.06, 0.10  # s of the flight that is compared
_CLEAR = 0.02  # s around the touch that the straight lines leave out
_STEP = 0.001  # s, of the engine in fits
_MOTORS = ("m1_pwm", "m2_pwm", "m3_pwm", "m4_pwm")
_COLUMNS = (
    *("t", "x", "y", "z", "vx", "vy", "vz", "qw", "qx", "qy", "qz", "cmd_roll", "cmd_pitch"),
    *_MOTORS,
)
# Fitted: restitution, contact time [s], height of the floor [m], change of the falling speed [m/s].
_SCALE = np.array([0.1, 0.005, 0.001, 0.02])
_LOW = np.array([0.02, 0.004, -0.006, -0.15])
_HIGH = np.array([0.9, 0.045, 0.006, 0.15])


@dataclasses.dataclass(frozen=True)
class Touchdown:
    """One measured touchdown; times in seconds from the touch, heights above the touch [m]."""

    flight: str
    time: np.ndarray  # (k,) from -BEFORE to AFTER
    height: np.ndarray  # (k,)
    commands: np.ndarray  # (k, 4), PWM in units of this project's vehicle
    state: np.ndarray  # (13,) at the first time, its height still that of the measurement
    down: float  # m/s, falling speed before, from a straight line
    up: float  # m/s, rising speed after
    tilt: float  # rad, between thrust and vertical at the touch
    thrust: float  # over the weight, mean around the touch

    @property
    def restitution(self) -> float:
        """Return the measured restitution: rising over falling speed."""
        return self.up / self.down


def command(
    flights: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    /,
    *,
    out: Folder,
) -> None:
    """Simulate the touchdowns of measured flights, and fit the contact setting to them.

    Args:
        flights: folder of NanoBench flights (nb_*.csv.gz), as `tests.validation.flights` converts them.
        out: new folder for table.md.
    """
    runs.check_new_run(out)
    found = compare(flights, load_vehicle())
    text = table_of(found["fits"]) + "\n" + table_of([found["summary"]])
    with runs.staged_run(out) as folder:
        storage.write_text(folder / "table.md", text)
    print(text)


def read_flights(folder: str | Path) -> dict[str, pd.DataFrame]:
    """Return the flights (nb_*.csv.gz) of a folder; raises UserError when it holds none or bad ones."""
    folder = Path(folder)
    if not folder.is_dir():
        raise UserError(f"the folder of flights {folder} does not exist")
    files = sorted(folder.glob("nb_*.csv.gz"))
    if not files:
        raise UserError(f"the folder {folder} holds no NanoBench flights (nb_*.csv.gz)")
    flights = {}
    for file in files:
        flights[file.name.removesuffix(".csv.gz")] = table = read_columns(file, _COLUMNS)
        if not (np.diff(table["t"]) > 0.0).all():
            raise UserError(f"{file}: the time t does not increase everywhere")
    return flights


def find_touchdowns(flights: dict[str, pd.DataFrame], vehicle: Vehicle) -> list[Touchdown]:
    """Return the first touchdown of each flight, where it has one with running motors and a rebound."""
    found = (_first_touchdown(name, table, vehicle) for name, table in flights.items())
    return [touchdown for touchdown in found if touchdown is not None]


def _first_touchdown(name: str, table: pd.DataFrame, vehicle: Vehicle) -> Touchdown | None:
    t, z, vz = (table[c].to_numpy() for c in ("t", "z", "vz"))
    motors = table[list(_MOTORS)].to_numpy()
    flying = (z > 0.5) & (np.abs(vz) < 0.2) & (motors.min(axis=1) > 0)
    if not flying.any():
        return None
    force = _static_force(motors, vehicle)
    ratio = force / np.median(force[flying])
    floor = np.min(z)
    low = (z < floor + 0.03) & (motors.min(axis=1) > 0) & (t > t[flying][0])
    for k in np.flatnonzero(low[1:-1] & (z[1:-1] <= z[:-2]) & (z[1:-1] < z[2:])) + 1:
        if t[k] < BEFORE + 0.05 or t[k] > t[-1] - AFTER - 0.05:
            continue
        early = (t > t[k] - 0.075) & (t < t[k] - _CLEAR)
        late = (t > t[k] + _CLEAR) & (t < t[k] + 0.085)
        before = np.polyfit(t[early] - t[k], z[early], 1)
        after = np.polyfit(t[late] - t[k], z[late], 2)
        touch = _crossing(before, after)
        if touch is None:
            continue
        down, up = -before[0], 2 * after[0] * touch + after[1]
        if down < 0.3 or up < 0.1:
            continue
        moment, level = t[k] + touch, np.polyval(before, touch)
        window = np.flatnonzero((t >= moment - BEFORE) & (t <= moment + AFTER))
        first = window[0]
        state = _state(table, first)
        state[Z] = np.polyval(before, t[first] - t[k]) - level
        state[VZ] = -down
        pwm = ratio[window] * vehicle.hover_pwm
        commands = np.zeros((len(window), 4))
        commands[:, 0] = np.clip(pwm, 0, vehicle.command_pwm_range[1])
        commands[:, 1:3] = table[["cmd_roll", "cmd_pitch"]].to_numpy()[window]
        near = np.abs(t - moment) < 0.05
        state[LAG] = commands[0, 0] / vehicle.thrust_lag_rate
        return Touchdown(
            flight=name,
            time=t[window] - moment,
            height=z[window] - level,
            commands=commands,
            state=state,
            down=float(down),
            up=float(up),
            tilt=float(np.arccos(np.cos(state[ROLL]) * np.cos(state[PITCH]))),
            thrust=float(ratio[near].mean()),
        )
    return None


def _static_force(pwm: np.ndarray, vehicle: Vehicle) -> np.ndarray:
    """Return the total force (k,) [N] of the static map for motor PWM (k, 4)."""
    # F = a u^2 + b u + c  of every running motor
    a, b, c = vehicle.motor_pwm_to_force
    return np.where(pwm > 0, a * pwm**2 + b * pwm + c, 0.0).sum(axis=1)


def _crossing(line: np.ndarray, parabola: np.ndarray) -> float | None:
    """Return the time where the falling line meets the rising parabola, nearest to zero; None without one."""
    roots = np.roots(parabola - np.array([0.0, *line]))
    real = roots.real[np.abs(roots.imag) < 1e-9]
    real = real[np.abs(real) < 0.03]
    return float(real[np.abs(real).argmin()]) if len(real) else None


def _state(table: pd.DataFrame, k: int) -> np.ndarray:
    """Return the state (13,) measured at row k; rates from the attitude over 40 ms."""
    rows = slice(k - 2, k + 3)
    quaternions = table[["qx", "qy", "qz", "qw"]].to_numpy()[rows]
    rotations = Rotation.from_quat(quaternions)
    yaw, roll, pitch = rotations[2].as_euler("ZXY")
    turned = (rotations[0].inv() * rotations[4]).as_rotvec() / (4 * PERIOD)
    state = np.zeros(STATE_SIZE)
    state[[ROLL, PITCH, YAW]] = roll, pitch, yaw
    state[[WX, WY, WZ]] = turned
    state[[VX, VY]] = table[["vx", "vy"]].to_numpy()[k]
    return state


class Simulation:
    """The touchdown in the MuJoCo plant: heights for rows of (restitution, contact time, floor, speed)."""

    def __init__(self, touchdown: Touchdown, n: int, vehicle: Vehicle):
        self.touchdown = touchdown
        self.plant = MujocoPlant(n, vehicle, control_period=PERIOD, timestep=_STEP)
        self.plant.set_platform(np.arange(n), vehicle.platform_inclination, False)
        # The measured point is low when the tilted vehicle's lowest foot touches: refer height to that.
        roll, pitch = touchdown.state[ROLL], touchdown.state[PITCH]
        up = -np.cos(roll) * np.sin(pitch), np.sin(roll), np.cos(roll) * np.cos(pitch)
        self.reach = float(reach_below(self.plant.shapes, up, part="feet"))

    def heights(self, rows: np.ndarray) -> np.ndarray:
        """Return the heights (n, k) [m] at the measured times, in the measurement's terms; rows (n, 4)."""
        n, sent = self.plant.n, self.touchdown.commands
        ids, gravity = np.arange(n), self.plant.vehicle.environment_gravity
        self.plant.set_contact(ids, solref=contact.spring(rows[:, 0], rows[:, 1], gravity))
        state = np.tile(self.touchdown.state, (n, 1))
        state[:, Z] += self.reach - rows[:, 2]
        state[:, VZ] += rows[:, 3]
        self.plant.reset(ids, state)
        flown = fly(self.plant, np.repeat(sent[:-1, None], n, axis=1))
        return flown[..., Z].T - self.reach + rows[:, 2:3]


@dataclasses.dataclass(frozen=True)
class Fit:
    """Restitution and contact time that reproduce one touchdown best."""

    touchdown: Touchdown
    restitution: float
    contact_time: float  # s
    rms: float  # m
    at_bound: bool


def fit(touchdown: Touchdown, vehicle: Vehicle) -> Fit:
    """Fit restitution, contact time, floor height and falling speed to the measured heights."""
    simulation = Simulation(touchdown, 5, vehicle)
    steps = np.array([0.2, 0.2, 0.2, 0.2])

    def runs(x):
        rows = np.tile(x, (5, 1))
        rows[1:] += np.diag(steps)
        return simulation.heights(rows * _SCALE)

    def residuals(x):
        return 1e3 * (runs(x)[0] - touchdown.height)

    def jacobian(x):
        heights = runs(x)
        return 1e3 * ((heights[1:] - heights[0]) / steps[:, None]).T

    start = np.array([min(max(touchdown.restitution, 0.1), 0.8), 0.02, 0.0, 0.0]) / _SCALE
    low, high = _LOW / _SCALE, _HIGH / _SCALE
    solution = least_squares(residuals, start, jacobian, bounds=(low, high), max_nfev=40)
    values = solution.x * _SCALE
    near = (solution.x[:2] - low[:2] < 1e-3) | (high[:2] - solution.x[:2] < 1e-3)
    return Fit(
        touchdown=touchdown,
        restitution=float(values[0]),
        contact_time=float(values[1]),
        rms=float(np.sqrt(np.mean((1e-3 * solution.fun) ** 2))),
        at_bound=bool(near.any()),
    )


def rebound(touchdown: Touchdown, restitution: float, contact_time: float, vehicle: Vehicle) -> float:
    """Return the rising speed [m/s] of the simulation, read off its heights as from the measurement."""
    simulation = Simulation(touchdown, 1, vehicle)
    heights = simulation.heights(np.array([[restitution, contact_time, 0.0, 0.0]]))[0]
    late = touchdown.time > _CLEAR
    curve = np.polyfit(touchdown.time[late], heights[late], 2)
    return float(curve[1])


def compare(folder: str | Path, vehicle: Vehicle) -> dict:
    """Return the touchdowns in `folder`, each fitted and predicted from the others (`fits`), and a `summary`.

    What fits is the height through the bounce, with a restitution of its own for each touchdown; one
    restitution for all does not. At 100 Hz the contact time is hardly resolved, and thrust is known relative
    to hover only.
    """
    found = find_touchdowns(read_flights(folder), vehicle)
    if len(found) < 2:
        raise UserError(
            f"the flights in {folder} hold {len(found)} usable touchdowns; at least two are needed"
        )
    fits = [fit(touchdown, vehicle) for touchdown in found]
    e, time = np.array([f.restitution for f in fits]), np.array([f.contact_time for f in fits])
    rows = []
    for k, f in enumerate(fits):
        usual = float(np.median(np.delete(e, k))), float(np.median(np.delete(time, k)))
        rows.append(
            {
                "flight": f.touchdown.flight,
                "down m/s": f.touchdown.down,
                "up m/s": f.touchdown.up,
                "tilt deg": float(np.degrees(f.touchdown.tilt)),
                "thrust / weight": f.touchdown.thrust,
                "restitution, data": f.touchdown.restitution,
                "restitution, fit": f.restitution,
                "contact time, fit ms": 1e3 * f.contact_time,
                "rms mm": 1e3 * f.rms,
                "up, predicted m/s": rebound(f.touchdown, *usual, vehicle),
            }
        )
    missed = np.array([row["up, predicted m/s"] - row["up m/s"] for row in rows])
    summary = {
        "worst rms mm": max(row["rms mm"] for row in rows),
        "median restitution": float(np.median(e)),
        "median contact time ms": 1e3 * float(np.median(time)),
        "rebound predicted from the others, rms m/s": float(np.sqrt(np.mean(missed**2))),
    }
    return {"fits": rows, "summary": summary}
