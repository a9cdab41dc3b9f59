"""`tosses`: those of a real cube against this project's contact.

TABLE is a CSV file with columns toss, t, x, y, z, qw, qx, qy, qz, vx, vy, vz, wx, wy, wz (SI units, rates in
the frame of the body, the table's surface at z = 0), such as the tosses of Pfrommer, Halm and Posa (CoRL
2020), by which Acosta, Yang and Posa (RA-L 2022) judge simulators. Mass, width, friction and restitution of
the cube are known.

Three questions:

- How far are predictions of whole tosses off, with the engine's defaults, with the best of a grid of its
  settings, with this project's map (`models.contact`) from the known friction and restitution, and with the
  contact that the tosses themselves give? The grid is chosen on TABLE.
- Which friction, restitution and height of the surface do the tosses give, and are these the known ones?
- How well does one law of contact describe all of them? The parameters are estimated from windows of several
  kinds (strikes, fast, medium and slow motion, sliding on a face). If the engine's law were nature's, all
  kinds would agree; their scatter is the error of the law, and part of the interval.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import mujoco
import numpy as np
import pandas as pd
import tyro
from scipy import stats
from scipy.spatial.transform import Rotation

from inclined_landing.models import contact
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.plants import MujocoPlant

from .shared import table_of

COLUMNS = ("toss", "t", *"xyz", "qw", "qx", "qy", "qz", "vx", "vy", "vz", "wx", "wy", "wz")
POSE, MOTION = slice(1, 8), slice(8, 14)  # columns of a toss: position and quaternion, velocity and rates
MASS, HALF = 0.37, 0.0524  # kg, m
# kg m2: what the authors use; that of a uniform cube of this size, 0.00068, predicts rotations worse.
INERTIA = 0.00081
KNOWN_FRICTION, KNOWN_RESTITUTION = 0.18, 0.125
GRAVITY = 9.81
SUBSTEPS = 4  # of the engine in an interval of the table
WINDOW = 10  # rows that a window of the estimation predicts ahead
TOUCHING = 0.004  # m: nearer than this the lowest corner may touch, whatever the table's height is
DEGREES_OF_FREEDOM = 4  # of the t distribution of errors
CONFIDENCE = 0.90
# Bounds and steps of the numerical derivatives: friction, restitution, log time [s], height [m].
LOWEST, HIGHEST = np.array([0.02, 0.0, np.log(0.006), -5e-3]), np.array([1.5, 0.9, np.log(0.08), 5e-3])
STEPS = np.array([0.03, 0.06, 0.25, 3e-4])
ITERATIONS = 8
LEAST = 40  # windows of a kind


@functools.cache
def scene_model() -> mujoco.MjModel:
    """Return the landing scene, whose solver settings the cube gets."""
    return MujocoPlant(1).model


@dataclasses.dataclass(frozen=True)
class Contact:
    """The contact of cube and table; without restitution and time the engine's default spring."""

    friction: float = 1.0
    restitution: float | None = None
    time: float = 0.02  # s
    height: float = 0.0  # m, of the surface
    spring: tuple[float, float] | None = None  # solref itself

    def model(self, interval: float) -> mujoco.MjModel:
        """Return the engine's model for a table of rows `interval` [s] apart."""
        spring = self.spring
        if self.restitution is not None:
            spring = tuple(contact.spring(self.restitution, self.time, GRAVITY).ravel())
        spec = mujoco.MjSpec()
        spec.option.timestep = interval / SUBSTEPS
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        how: dict = {"friction": [self.friction, 0.005, 0.0001]}
        if spring is not None:
            how["solref"] = spring
        if self.restitution is not None:  # the project's contact is the whole of it, not the spring alone
            scene = scene_model()
            spec.option.impratio = scene.opt.impratio
            how["solimp"] = scene.geom("slab").solimp
        plane, box = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_BOX
        spec.worldbody.add_geom(type=plane, size=[5, 5, 0.1], pos=[0, 0, self.height], **how)
        cube = spec.worldbody.add_body()
        cube.add_freejoint()
        cube.add_geom(type=box, size=[HALF] * 3, mass=MASS, **how)
        model = spec.compile()
        model.body_inertia[1] = INERTIA
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model


def read(path: Path) -> list[np.ndarray]:
    """Return the tosses of a table, each (k, 14): time, pose, motion. Raises UserError for other tables."""
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise UserError(f"table of tosses {path}: {error}") from error
    if missing := set(COLUMNS) - set(table):
        raise UserError(f"table of tosses {path} lacks the columns {', '.join(sorted(missing))}")
    return [group[list(COLUMNS[1:])].to_numpy(float) for _, group in table.groupby("toss", sort=False)]


def interval_of(tosses: Sequence[np.ndarray]) -> float:
    """Return the time between two rows [s]."""
    return float(np.median(np.diff(tosses[0][:, 0])))


def lowest_corner(toss: np.ndarray) -> np.ndarray:
    """Return the height (k,) of the lowest corner over z = 0 [m]."""
    corners = HALF * np.array(list(itertools.product((-1, 1), repeat=3)))
    turned = np.einsum("kij,cj->kci", Rotation.from_quat(toss[:, [5, 6, 7, 4]]).as_matrix(), corners)
    return (turned[..., 2] + toss[:, None, 3]).min(axis=1)


def released(toss: np.ndarray) -> np.ndarray:
    """Return the first row (14,) with the motion that the flight before the first touch shows.

    The table's velocities are smoothed derivatives. Until the cube touches, its centre moves on a parabola
    and its rates are constant: a fit of the measured poses gives both.
    """
    row, t = toss[0].copy(), toss[:, 0] - toss[0, 0]
    n = int(np.argmax(lowest_corner(toss) < TOUCHING)) - 1
    if n < 4:
        return row
    fallen = toss[:n, 1:4] + 0.5 * GRAVITY * t[:n, None] ** 2 * np.array([0, 0, 1])
    row[8:11], row[1:4] = np.polyfit(t[:n], fallen, 1)
    attitude = Rotation.from_quat(toss[:n, [5, 6, 7, 4]])
    row[11:14] = t[:n] @ (attitude[0].inv() * attitude).as_rotvec() / (t[:n] ** 2).sum()
    return row


def fly(model: mujoco.MjModel, start: np.ndarray, rows: int) -> np.ndarray:
    """Return the poses (rows, 7) from a row (14,) on."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start[POSE], start[MOTION]
    poses = np.empty((rows, 7))
    for k in range(rows):
        poses[k] = data.qpos
        mujoco.mj_step(model, data, SUBSTEPS)
    return poses


def errors(setting: Contact, tosses: Sequence[np.ndarray], fitted_start: bool = True) -> np.ndarray:
    """Return the mean errors (n, 2) over each toss: of the position [cube widths], the attitude [deg]."""
    model, found = setting.model(interval_of(tosses)), []
    for toss in tosses:
        poses = fly(model, released(toss) if fitted_start else toss[0], len(toss))
        away = np.linalg.norm(poses[:, :3] - toss[:, 1:4], axis=1) / (2 * HALF)
        flown, seen = (Rotation.from_quat(q[:, [1, 2, 3, 0]]) for q in (poses[:, 3:], toss[:, 4:8]))
        found.append((away.mean(), np.degrees((flown.inv() * seen).magnitude()).mean()))
    return np.array(found)


# ---- which contact the tosses give


@dataclasses.dataclass(frozen=True)
class Windows:
    """Predictions of WINDOW rows from measured states (n, 14) to poses (n, 7), and their tosses (n,)."""

    start: np.ndarray
    end: np.ndarray
    toss: np.ndarray

    def only(self, which: np.ndarray) -> Windows:
        """Return some of the windows."""
        return Windows(self.start[which], self.end[which], self.toss[which])


def windows_of(tosses: Sequence[np.ndarray]) -> Windows:
    """Return the windows in which the moving cube may touch the table, none of them overlapping."""
    found = []
    for number, toss in enumerate(tosses):
        low = lowest_corner(toss)
        for k in range(2, len(toss) - WINDOW - 2, WINDOW):
            moving = np.linalg.norm(toss[k, 8:11]) > 0.15  # m/s
            if moving and low[k : k + WINDOW + 1].min() < TOUCHING:
                found.append((toss[k], toss[k + WINDOW, POSE], number))
    if not found:
        raise UserError("in these tosses the cube never touches the table")
    start, end, number = map(np.array, zip(*found))
    return Windows(start, end, number)


def kinds_of(windows: Windows) -> dict[str, np.ndarray]:
    """Return which windows (n,) are strikes, and which show what kind of motion in contact."""
    sideways = np.linalg.norm(windows.start[:, 8:10], axis=1)
    strikes = windows.start[:, 10] < -0.5
    sliding = ~strikes & (np.linalg.norm(windows.start[:, 11:14], axis=1) < 1.0)
    rolling = ~strikes & ~sliding
    return {
        "strikes (falls faster than 0.5 m/s)": strikes,
        "tumbles, over 1 m/s": rolling & (sideways >= 1.0),
        "tumbles, 0.5 to 1 m/s": rolling & (sideways >= 0.5) & (sideways < 1.0),
        "tumbles, below 0.5 m/s": rolling & (sideways < 0.5),
        "slides on a face": sliding,
    }


def residuals(at: np.ndarray, windows: Windows, interval: float) -> np.ndarray:
    """Return the errors (n, 6) of the poses predicted with the parameters `at`: m, rad."""
    setting = Contact(at[0], at[1], float(np.exp(at[2])), at[3])
    model, out = setting.model(interval), np.empty((len(windows.start), 6))
    for k, (start, end) in enumerate(zip(windows.start, windows.end)):
        pose = fly(model, start, WINDOW + 1)[-1]
        out[k, :3] = pose[:3] - end[:3]
        mujoco.mju_subQuat(out[k, 3:], pose[3:], end[3:] / np.linalg.norm(end[3:]))
    return out


def estimate(windows: Windows, interval: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the parameters (4,) of `STEPS` that predict windows best, and their covariance (4, 4).

    Errors have a t distribution, whose scale is that of their median: Gauss-Newton steps with its weights
    w = (nu + 1)/(nu + z^2). The covariance A^-1 (sum g g') A^-1 takes the gradients g of whole tosses, so
    that windows of a toss need not be independent.
    """
    at = np.array([0.25, 0.2, np.log(0.02), 0.0])
    for _ in range(ITERATIONS):
        found = residuals(at, windows, interval)
        scale = stats.norm.ppf(0.75) ** -1 * np.median(np.abs(found), axis=0)
        columns = []
        for step in np.diag(STEPS):
            ends = np.clip([at - step, at + step], LOWEST, HIGHEST)
            low, high = (residuals(end, windows, interval) for end in ends)
            columns.append((high - low) / (ends[1] - ends[0]).sum())
        z, slopes = found / scale, np.stack(columns, axis=-1) / scale[:, None]
        weight = (DEGREES_OF_FREEDOM + 1) / (DEGREES_OF_FREEDOM + z**2)
        curvature = np.einsum("nci,nc,ncj->ij", slopes, weight, slopes)
        pull = np.einsum("nci,nc,nc->ni", slopes, weight, z)
        step = np.linalg.solve(curvature + 1e-3 * np.diag(np.diag(curvature)), pull.sum(axis=0))
        at = np.clip(at - np.clip(step, -2 * STEPS, 2 * STEPS), LOWEST, HIGHEST)
    by_toss = np.zeros((windows.toss.max() + 1, len(at)))
    np.add.at(by_toss, windows.toss, pull)
    inverse = np.linalg.inv(curvature)
    return at, inverse @ (by_toss.T @ by_toss) @ inverse


def pooled(values: np.ndarray, variances: np.ndarray) -> tuple[float, float, float]:
    """Return the mean of one parameter over kinds of motion, with the ends of its prediction interval.

    Random effects: tau^2, the scatter of the kinds beyond their own errors v, by DerSimonian and Laird;
    weights 1/(v + tau^2). The interval is that of a kind not seen: sqrt(tau^2 + var) times Student's t with
    n - 2 degrees of freedom (Higgins, Thompson, Spiegelhalter 2009).
    """
    weight = 1.0 / variances
    mean, n = (weight * values).sum() / weight.sum(), len(values)
    q = (weight * (values - mean) ** 2).sum()
    tau2 = max(0.0, (q - (n - 1)) / (weight.sum() - (weight**2).sum() / weight.sum()))
    weight = 1.0 / (variances + tau2)
    mean = (weight * values).sum() / weight.sum()
    half = stats.t.ppf(0.5 + CONFIDENCE / 2, n - 2) * np.sqrt(tau2 + 1.0 / weight.sum())
    return float(mean), float(mean - half), float(mean + half)


# ---- the answers


def grid() -> list[Contact]:
    """Return the settings of the engine alone: friction, and the time and damping of its spring."""
    times, dampings = (0.004, 0.008, 0.016, 0.02, 0.04), (0.5, 1.0)
    springs = [(time, damping) for time in times for damping in dampings]
    return [Contact(mu, spring=spring) for mu in (0.14, 0.18, 0.22) for spring in springs]


def best_of(settings: Sequence[Contact], tosses: Sequence[np.ndarray]) -> Contact:
    """Return the setting with the smallest mean error of the position, as shares of that of the attitude."""
    found = np.array([errors(setting, tosses).mean(axis=0) for setting in settings])
    return settings[int(np.argmin((found / found.min(axis=0)).sum(axis=1)))]


def command(chosen: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TABLE")], /) -> None:
    """Contact that tosses of a real cube give, and how far predictions with it are off (minutes).

    Args:
        chosen: tosses, on which the grid of the engine's settings is chosen too.
    """
    tosses = read(chosen)
    interval, windows = interval_of(tosses), windows_of(tosses)
    kinds = {kind: windows.only(which) for kind, which in kinds_of(windows).items() if which.sum() >= LEAST}
    fits = {kind: estimate(some, interval) for kind, some in kinds.items()}
    z = stats.norm.ppf(0.5 + CONFIDENCE / 2)
    lines = []
    for kind, (at, covariance) in fits.items():
        half = z * np.sqrt(np.diag(covariance))
        cells = {"friction": f"{at[0]:.3f} ± {half[0]:.3f}", "restitution": f"{at[1]:.2f} ± {half[1]:.2f}"}
        cells |= {"surface [mm]": f"{1e3 * at[3]:.2f} ± {1e3 * half[3]:.2f}"}
        lines.append({"motion in contact": kind, "windows": len(kinds[kind].start)} | cells)
    values = np.array([at for at, _ in fits.values()])
    variances = np.array([np.diag(covariance) for _, covariance in fits.values()])
    together = [pooled(values[:, k], variances[:, k]) for k in range(len(STEPS))]
    friction, restitution, (time, *_), (height, *_) = together
    cells = {"friction": _interval(friction, KNOWN_FRICTION, ".3f")}
    cells |= {"restitution": _interval(restitution, KNOWN_RESTITUTION, ".2f")}
    cells |= {"surface [mm]": _interval([1e3 * x for x in together[3]], None, ".2f")}
    lines.append({"motion in contact": "together, for a kind not seen", "windows": ""} | cells)
    print(table_of(lines))
    struck = next(iter(fits.values()))[0]  # the first impacts decide where a toss goes
    settings = {
        "the engine's defaults": Contact(),
        "the engine, known friction": Contact(KNOWN_FRICTION),
        "the engine, best of a grid": best_of(grid(), tosses),
        "this project's map, known friction and restitution": Contact(KNOWN_FRICTION, KNOWN_RESTITUTION),
        "this project's map, contact of the strikes, height of all": Contact(
            struck[0], struck[1], float(np.exp(time)), height
        ),
    }
    print(table_of([_predicted(name, setting, tosses) for name, setting in settings.items()]))


def _interval(ends: Sequence[float], known: float | None, form: str) -> str:
    value, low, high = (format(x, form) for x in ends)
    return f"{value} [{low}, {high}]" + ("" if known is None else f"; known {known}")


def _predicted(name: str, setting: Contact, tosses: Sequence[np.ndarray]) -> dict:
    """Return the mean errors over whole tosses, in brackets with the table's velocity, and the medians."""
    found, given = (errors(setting, tosses, fitted_start=fitted) * [100.0, 1.0] for fitted in (True, False))
    (place, angle), (place_given, angle_given) = found.mean(axis=0), given.mean(axis=0)
    middle = np.median(found, axis=0)
    return {
        "contact": name,
        "position [% of the width]": f"{place:.1f} ({place_given:.1f})",
        "attitude [deg]": f"{angle:.1f} ({angle_given:.1f})",
        "medians": f"{middle[0]:.1f}, {middle[1]:.1f}",
    }
