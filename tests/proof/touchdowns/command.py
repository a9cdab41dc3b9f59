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

import matplotlib
import numpy as np
import pandas as pd
import tyro
from matplotlib.figure import Figure
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from inclined_landing.envs.shared import runs
from inclined_landing.eval.base.claims import Section, Table
from inclined_landing.eval.base.options import Folder, VehicleFile
from inclined_landing.eval.base.style import INK, ORANGE, styled
from inclined_landing.eval.logs.csv_file import read_columns
from inclined_landing.eval.truth.contact.command import contact_record
from inclined_landing.eval.truth.report import Words, publish
from inclined_landing.models import contact
from inclined_landing.models.attitude import LAG, PITCH, ROLL, STATE_SIZE, VX, VY, VZ, WX, WY, WZ, YAW, Z
from inclined_landing.models.errors import UserError
from inclined_landing.models.geometry import reach_below
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import fly
from inclined_landing.models.vehicle import Vehicle

WORDS = Words(__package__)
PERIOD = 0.01  # s, of the measurements
BEFORE, AFTER = 0.06, 0.10  # s of the flight that is compared
_CLEAR = 0.02  # s around the touch that the straight lines leave out
_STEP = 0.001  # s, of the engine in fits
_MOTORS = ("m1_pwm", "m2_pwm", "m3_pwm", "m4_pwm")
_COLUMNS = (
    *("t", "x", "y", "z", "vx", "vy", "vz", "qw", "qx", "qy", "qz", "imu_az", "cmd_roll", "cmd_pitch"),
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
    slide: float  # m/s, horizontal speed before
    thrust: float  # over the weight, mean around the touch
    shock: float  # m/s2, largest reading of the accelerometer within 50 ms

    @property
    def restitution(self) -> float:
        """Return the measured restitution: rising over falling speed."""
        return self.up / self.down


def command(
    flights: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    /,
    *,
    out: Folder,
    vehicle: VehicleFile = None,
) -> None:
    """Simulate the touchdowns of measured flights, and fit the contact setting to them.

    Args:
        flights: folder of NanoBench flights (nb_*.csv.gz), as `landing-eval flights` converts them.
        out: new folder for touchdowns.html, touchdowns.json and the figure.
        vehicle: vehicle file (TOML), where it differs from the shipped one.
    """
    runs.check_new_run(out)
    found = section(flights, load_vehicle(vehicle))
    publish(
        out,
        "touchdowns",
        [found],
        {"touchdowns.png": draw(found.data)},
        contact_record([found]),
        title="Measured touchdowns",
        lead="NanoBench flights, and the same touchdowns of the MuJoCo vehicle.",
        run="python -m tests.proof touchdowns",
    )


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
            slide=float(np.hypot(state[VX], state[VY])),
            thrust=float(ratio[near].mean()),
            shock=float(table["imu_az"].to_numpy()[near].max()),
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
    """Restitution and contact time that reproduce one touchdown best, with standard errors."""

    touchdown: Touchdown
    restitution: float
    contact_time: float  # s
    errors: tuple[float, float]
    heights: np.ndarray  # (k,) m, of the fit
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
    # Covariance of a least-squares fit:  s^2 (J'J)^-1,  s^2 = |r|^2 / (n - 4)
    spread = solution.fun @ solution.fun / max(len(solution.fun) - 4, 1)
    covariance = spread * np.linalg.pinv(solution.jac.T @ solution.jac)
    errors = np.sqrt(np.diag(covariance)) * _SCALE
    values = solution.x * _SCALE
    near = (solution.x[:2] - low[:2] < 1e-3) | (high[:2] - solution.x[:2] < 1e-3)
    return Fit(
        touchdown=touchdown,
        restitution=float(values[0]),
        contact_time=float(values[1]),
        errors=(float(errors[0]), float(errors[1])),
        heights=simulation.heights(np.tile(values, (5, 1)))[0],
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


def section(folder: str | Path, vehicle: Vehicle) -> Section:
    """Return the section on the touchdowns in `folder`, each fitted, and predicted from the others."""
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
        rows.append(_row(f, rebound(f.touchdown, *usual, vehicle)))
    missed = np.array([row["predicted_up"] - row["up"] for row in rows])
    measured = {
        "height": 1e3 * max(row["rms"] for row in rows),
        "restitution": float(np.median(e)),
        "contact_time": 1e3 * float(np.median(time)),
        "rebound": float(np.sqrt(np.mean(missed**2))),
    }
    cells = [(row["flight"], *(float(factor * row[key]) for key, factor in _SHOWN.values())) for row in rows]
    table = Table("Touchdowns", ("flight", *_SHOWN), cells)
    return WORDS.section("touchdowns", measured, {"count": len(rows)}, tables=[table], data={"fits": rows})


# Heading of a column of the page's table -> key of a row, factor.
_SHOWN = {
    "down [m/s]": ("down", 1.0),
    "up [m/s]": ("up", 1.0),
    "tilt [deg]": ("tilt_deg", 1.0),
    "thrust / weight": ("thrust", 1.0),
    "restitution, data": ("restitution_measured", 1.0),
    "restitution, fit": ("restitution", 1.0),
    "contact time, fit [ms]": ("contact_time", 1e3),
    "rms [mm]": ("rms", 1e3),
    "up, predicted [m/s]": ("predicted_up", 1.0),
}


def _row(f: Fit, predicted_up: float) -> dict:
    """Return the measured and fitted numbers of one touchdown, as contact.json has them."""
    measured = ("flight", "down", "up", "slide", "thrust", "shock", "time")
    fitted = ("restitution", "contact_time", "rms", "at_bound")
    return {name: getattr(f.touchdown, name) for name in measured} | {
        **{name: getattr(f, name) for name in fitted},
        "tilt_deg": float(np.degrees(f.touchdown.tilt)),
        "restitution_measured": f.touchdown.restitution,
        "restitution_error": f.errors[0],
        "contact_time_error": f.errors[1],
        "predicted_up": predicted_up,
        "measured": f.touchdown.height,
        "simulated": f.heights,
    }


def draw(data: dict) -> Figure:
    """Return a figure of measured and simulated heights [mm] after contact, a panel per touchdown."""
    fits = data["fits"]
    columns = 4
    rows = -(-len(fits) // columns)
    with styled(), matplotlib.rc_context({"axes.grid": True}):
        figure = Figure(figsize=(2.6 * columns, 0.6 + 2.0 * rows), layout="constrained")
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for axes, row in zip(grid.ravel(), fits):
            time = 1e3 * row["time"]
            axes.plot(time, 1e3 * row["measured"], "o", color=INK, ms=3, label="measured")
            axes.plot(time, 1e3 * row["simulated"], color=ORANGE, lw=1.5, label="simulated")
            title = row["flight"].removeprefix("nb_").replace("_", " ")
            fitted = f"restitution {row['restitution']:.2f}, {1e3 * row['contact_time']:.0f} ms"
            axes.set_title(f"{title}\n{fitted}", size=8.5)
        for axes in grid.ravel()[len(fits) :]:
            axes.set_visible(False)
        figure.supxlabel("time after the touch [ms]", size=9.5)
        figure.supylabel("height [mm]", size=9.5)
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure
