"""Measurements of contact against the laws of mechanics, each returned as a `Section`.

Everything is unpowered and uses the default contact setting unless stated otherwise.
"""

from __future__ import annotations

import dataclasses
import itertools
from functools import partial
from typing import Any

import numpy as np

from inclined_landing.eval.base.claims import Section
from inclined_landing.eval.truth.contact.drops import PHASES, advance, drop, energy, unpowered
from inclined_landing.eval.truth.contact.figures import DRAW
from inclined_landing.eval.truth.report import Words
from inclined_landing.models import contact
from inclined_landing.models.attitude import ROLL, STATE_SIZE, VX, VZ, WX, WZ, YAW
from inclined_landing.models.motion import Motion
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import STEP, present_forces
from inclined_landing.models.surface import normal_of, split
from inclined_landing.models.vehicle import Vehicle

WORDS = Words(__package__)  # with the tolerances
GRIP = 1.6  # friction that holds the vehicle on every supported slope (tan 50 deg = 1.19)
FALL = 0.6  # s of a random drop, unless it is decided before
HELD = 2.0 * contact.CONTACT_TIME[1]  # s; no contact spring holds energy for as long
STUDY_TIME = 0.02  # s, contact time of the settings that are compared
RESTITUTIONS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
CONTACT_TIMES = (0.012, 0.016, 0.02, 0.024)
STEPS = (0.004, 0.002, 0.001, 0.0005)


def _section(key: str, measured: dict[str, float], filling: dict | None = None, *, data: dict) -> Section:
    return WORDS.section(key, measured, filling, data=data, draw=partial(DRAW[key], data))


def rest(vehicle: Vehicle) -> Section:
    """Measure forces and creep at rest on slopes of 0 to 50 degrees."""
    degrees = np.arange(0.0, 51.0, 5.0)
    alpha = np.radians(degrees)
    n = len(alpha)
    plant = unpowered(vehicle, n, -alpha)
    plant.set_contact(np.arange(n), friction=GRIP)
    creep = _creep(plant)
    total = np.array([present_forces(plant, k)[1].sum(axis=0) for k in range(n)])
    forces = np.stack(split(total, plant.inclination), axis=1)
    # At rest on a slope:  N = m g cos(alpha),  T = m g sin(alpha)
    weight = vehicle.body_mass * vehicle.environment_gravity
    expected = weight * np.stack([np.cos(alpha), np.sin(alpha)], axis=1)
    error = np.abs(forces - expected).max() / weight

    default = float(_creep(unpowered(vehicle, 1, vehicle.platform_inclination))[0])
    springy = unpowered(vehicle, len(RESTITUTIONS), vehicle.platform_inclination)
    springy.set_contact(np.arange(springy.n), restitution=np.array(RESTITUTIONS), contact_time=STUDY_TIME)
    of_restitution = _creep(springy)
    return _section(
        "rest",
        {
            "forces": 100 * error,
            "default_creep": 1e3 * default,
            "creep": 1e3 * creep.max(),
            "springy_creep": 1e3 * of_restitution.max(),
        },
        {"study_time": 1e3 * STUDY_TIME, "grip": GRIP},
        data={
            "degrees": degrees,
            "normal": forces[:, 0],
            "tangential": forces[:, 1],
            "expected": expected,
            "creep": creep,
            "restitution": RESTITUTIONS,
            "creep_of_restitution": of_restitution,
        },
    )


def _creep(plant: MujocoPlant) -> np.ndarray:
    """Return the speed [m/s] of every vehicle over 2 s, after 1 s to settle."""
    advance(plant, 1.0)
    moved = advance(plant, 2.0)
    return np.linalg.norm(moved[-1, :, :3] - moved[0, :, :3], axis=1) / 2.0


def slip(vehicle: Vehicle) -> Section:
    """Measure the angle of friction: the inclination at which a vehicle at rest begins to slide."""
    # Coulomb: slip begins at tan(alpha) = mu
    frictions = np.array([0.2, 0.3, 0.5, 0.8, 1.0])
    around = np.radians(np.round(np.arange(-0.6, 1.01, 0.1), 1))
    alpha = (np.arctan(frictions)[:, None] + around).ravel()
    plant = unpowered(vehicle, len(alpha), -alpha)
    plant.set_contact(np.arange(plant.n), friction=np.repeat(frictions, len(around)))
    advance(plant, 0.2)
    moved = advance(plant, 0.5)
    distance = np.linalg.norm(moved[-1, :, :3] - moved[0, :, :3], axis=1).reshape(len(frictions), -1)
    before, after = np.linalg.norm(moved[[0, -1], :, VX : VZ + 1], axis=2)
    gained = (after - before).reshape(distance.shape) / 0.5
    slides = gained > 0.005  # m/s2; 0.03 degrees beyond the angle of friction
    onset = np.degrees(around)[slides.argmax(axis=1)]
    return _section(
        "slip",
        {"onset": float(np.abs(onset).max())},
        data={
            "friction": frictions,
            "around": np.degrees(around),
            "acceleration": gained,
            "distance": distance,
            "onset": np.degrees(np.arctan(frictions)) + onset,
        },
    )


def restitution(vehicle: Vehicle) -> Section:
    """Measure restitution and contact time of drops against their settings."""
    gravity = vehicle.environment_gravity
    pairs = np.array([(e, t) for t in CONTACT_TIMES for e in RESTITUTIONS])
    solrefs = contact.solref(pairs[:, 0], pairs[:, 1], gravity)
    shape = (len(CONTACT_TIMES), len(RESTITUTIONS))
    speeds = (0.5, 1.0, 1.5)
    drops = {speed: drop(vehicle, speed, solrefs) for speed in speeds}
    measured = {speed: d.restitution.mean(axis=1).reshape(shape) for speed, d in drops.items()}
    scatter = drops[1.0].restitution.std(axis=1).reshape(shape)
    pushed = drops[1.0].pushed.mean(axis=1).reshape(shape)
    # Newton: e = v_after / v_before;  a linear spring-damper pushes for its contact time.
    off = np.abs(measured[1.0] - np.array(RESTITUTIONS))[:, 1:]
    late = np.abs(pushed - np.array(CONTACT_TIMES)[:, None])[:, 1:]
    return _section(
        "restitution",
        {
            "set": float(off[1:].max()),
            "shortest": float(off[0].max()),
            "scatter": float(scatter.max()),
            "contact_time": 1e3 * float(np.nanmax(late)),
        },
        {"phases": PHASES},
        data={
            "set": RESTITUTIONS,
            "contact_time": CONTACT_TIMES,
            "scatter": scatter,
            "pushed": pushed,
            "speeds": speeds,
            **{f"measured at {speed:g} m/s": value for speed, value in measured.items()},
        },
    )


def impulse(vehicle: Vehicle) -> Section:
    """Measure the impulse of recorded and of sampled forces against that of the contact forces."""
    spring = contact.solref([0.0, 0.3, 0.6], STUDY_TIME, vehicle.environment_gravity)
    rows = []
    for step in STEPS:
        for name, solrefs in (("default", None), ("0.6", spring[2:])):
            d = drop(vehicle, 1.0, solrefs, step)
            error = (d.sampled / d.recorded - 1.0)[0]
            rows.append((step, name, float(error.mean()), float(np.abs(error).max()), float(d.peak.mean())))
    mean = [row for row in rows if row[0] == STEP]
    fine = [row for row in rows if row[0] == STEPS[-1]]
    kinds = itertools.product((0.3, 1.0, 2.0), (None, spring), (0.0, 0.5))
    drops = [drop(vehicle, speed, s, stages=True, thrust=share) for speed, s, share in kinds]
    single = max(float(np.abs(d.recorded / d.impulse - 1.0).max()) for d in drops)
    return _section(
        "impulse",
        {
            "touch": 100 * single,
            "sampled_mean": 100 * max(abs(row[2]) for row in mean),
            "sampled_fine": 100 * max(row[3] for row in fine),
        },
        data={"rows": [dict(zip(("step", "setting", "mean", "worst", "peak"), row)) for row in rows]},
    )


def penetration(vehicle: Vehicle) -> Section:
    """Measure the penetration depth of the feet over speed and contact time."""
    speeds = np.array([0.25, 0.5, 1.0, 1.5, 2.0])
    gravity = vehicle.environment_gravity
    solrefs = contact.solref(0.3, np.array(CONTACT_TIMES), gravity)
    default = np.array([drop(vehicle, speed).depth.max() for speed in speeds])
    depth = np.array([drop(vehicle, speed, solrefs).depth.max(axis=1) for speed in speeds])
    at_one = int(np.flatnonzero(speeds == 1.0)[0])
    grows = float(np.diff(depth, axis=1).min())
    return _section(
        "penetration",
        {"depth": 1e3 * float(default[at_one]), "growth": 1e3 * grows},
        data={"speeds": speeds, "contact_time": CONTACT_TIMES, "default": default, "depth": depth},
    )


def convergence(vehicle: Vehicle) -> Section:
    """Measure the convergence of rebound and penetration depth with the step."""
    gravity = vehicle.environment_gravity
    solrefs = contact.solref([0.3, 0.6], STUDY_TIME, gravity)
    steps = (*STEPS, 0.00025)
    drops = [drop(vehicle, 1.0, solrefs, step) for step in steps]
    rebound = np.array([d.restitution.mean(axis=1) for d in drops])
    spread = np.array([d.restitution.std(axis=1) for d in drops])
    depth = np.array([drop(vehicle, 1.0, None, step).depth.mean() for step in steps])
    error = np.abs(depth - depth[-1])[:-1]
    # error ~ h^p:  p is the slope of log(error) over log(h)
    order = float(np.polyfit(np.log(steps[:-2]), np.log(error[:-1]), 1)[0])
    change = float(np.abs(rebound[0] - rebound[-1]).max())
    halving = float((spread[1:] / spread[:-1])[:3].mean())
    return _section(
        "convergence",
        {"order": order, "scatter": halving, "rebound": change},
        data={"steps": steps, "rebound": rebound, "scatter": spread, "depth": depth},
    )


def tumbling(vehicle: Vehicle, n: int = 100, dropped: int = 1000) -> Section:
    """Measure the energy gain of passive drops in random attitudes, and how many pass through the slab."""
    speeds = (0.5, 1.0, 2.0, 4.0, contact.FASTEST)
    settings = (None, *RESTITUTIONS[::3])
    growth = np.zeros((len(settings), len(speeds)))
    share = np.zeros_like(growth)
    slope = np.full(n, vehicle.platform_inclination)
    for i, setting in enumerate(settings):
        for j, speed in enumerate(speeds):
            spring = {} if setting is None else {"restitution": setting, "contact_time": STUDY_TIME}
            gain, _ = follow(fall_at(vehicle, np.full(n, speed), slope, spring))
            growth[i, j], share[i, j] = gain.max(), (gain > 0.01).mean()
    rng = np.random.default_rng(1)
    slope = -rng.uniform(0.0, vehicle.platform_max_inclination, dropped)
    speed = rng.uniform(1.0, contact.FASTEST, dropped)
    restitutions = rng.uniform(*contact.RESTITUTION, dropped)
    times = rng.uniform(*contact.CONTACT_TIME, dropped)
    spring = {"solref": contact.solref(restitutions, times, vehicle.environment_gravity)}
    kinds = {
        "through": ({}, "slab"),
        "springy_through": (spring, "slab"),
        "wall_through": (spring, "wall"),
        "moving_through": (spring, "moving slab"),
    }
    through = {
        key: int(follow(fall_at(vehicle, speed, slope, setting, onto))[1].sum())
        for key, (setting, onto) in kinds.items()
    }
    return _section(
        "tumbling",
        {
            "default": 100 * float(growth[0].max()),
            "springy": 100 * float(growth[1:-1].max()),
            "springiest": 100 * float(share[-1].max()),
            **through,
        },
        {"n": n, "dropped": dropped, "fastest": contact.FASTEST, "held": 1e3 * HELD},
        data={
            "speeds": speeds,
            "settings": [s if s is not None else "default" for s in settings],
            "growth": growth,
            "share": share,
            "through": through,
        },
    )


@dataclasses.dataclass(frozen=True)
class Falling:
    """Vehicles that fly at surfaces in random attitudes and spins; arrays of n rows."""

    plant: MujocoPlant
    speed: np.ndarray  # (n,) m/s into the surface
    point: np.ndarray  # (n, 3) m, on the surface, at which the vehicle flies
    normal: np.ndarray  # (n, 3) of the surface
    rising: np.ndarray  # (n, 3) m/s, velocity of the surface

    def relative(self, ids: np.ndarray, time: float) -> np.ndarray:
        """Return the present states (k, 13) of the vehicles `ids`, `time` [s] after the start, less the
        surface's motion since then.
        """
        state, rising = self.plant.state[ids], self.rising[ids]
        state[:, :3] -= rising * time
        state[:, VX : VZ + 1] -= rising
        return state


def fall_at(
    vehicle: Vehicle, speed: np.ndarray, slope: np.ndarray, spring: dict[str, Any], onto: str = "slab"
) -> Falling:
    """Return vehicles before they reach a surface.

    speed (n,) [m/s] into it; slope (n,) [rad] of the slab; spring: contact settings, if not the default.
    onto: the slab; a moving slab, which rises along its normal by half of that speed; or, level, one of the
    base's two walls.
    """
    n = len(speed)
    plant = unpowered(vehicle, n, moving=onto == "moving slab")
    ids, rng = np.arange(n), np.random.default_rng(0)
    plant.set_platform(ids, slope)
    plant.set_contact(ids, **spring)
    normal, point = normal_of(slope), np.zeros((n, 3))
    point[:, 2] = vehicle.platform_surface_height
    if onto == "wall":
        normal = rng.choice([-1.0, 1.0], n)[:, None] * [1.0, 0.0, 0.0]
        point = normal * vehicle.slab_half_length * np.cos(slope)[:, None] + [0.0, 0.0, 0.4]
    rising = normal * speed[:, None] * (0.5 if onto == "moving slab" else 0.0)
    if rising.any():
        plant.set_motion(ids, Motion(*Motion.still(n).waves._replace(velocity=rising)))
    state = np.zeros((n, STATE_SIZE))
    state[:, ROLL : YAW + 1] = rng.uniform(-1, 1, (n, 3)) * [np.pi, 1.5, np.pi]
    state[:, WX : WZ + 1] = rng.normal(0, 5, (n, 3))
    state[:, :3] = point + normal * 0.075
    state[:, VX : VZ + 1] = rising - normal * speed[:, None]
    plant.reset(ids, state)
    return Falling(plant, speed, point, normal, rising)


def follow(falling: Falling) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest gains of energy (n,), as shares of the impact's, and (n,) which vehicles passed.

    Energy is that of motion relative to the surface, and of height. A vehicle has passed if it is behind the
    surface, near where it flew at it. Each is followed for FALL, or until it has passed, or until it has been
    above the surface for HELD with half of its impact's energy lost: it returns with less than it came with.
    """
    plant, vehicle, n = falling.plant, falling.plant.vehicle, falling.plant.n
    gain, passed, spent, off = np.zeros(n), np.zeros(n, bool), np.zeros(n), np.zeros((n, 4))
    impact = 0.5 * vehicle.body_mass * falling.speed**2
    active = np.arange(n)
    begun = energy(falling.relative(active, 0.0), vehicle)
    for k in range(1, round(FALL / STEP) + 1):
        plant.advance(off, active)
        plant.check()
        state, normal = falling.relative(active, STEP * k), falling.normal[active]
        gained = (energy(state, vehicle) - begun[active]) / impact[active]
        gain[active] = np.maximum(gain[active], gained)
        away = state[:, :3] - falling.point[active]
        height = (away * normal).sum(axis=1)
        aside = np.linalg.norm(away - height[:, None] * normal, axis=1)
        passed[active] = (height < -vehicle.platform_thickness) & (aside < 0.2)
        spent[active] = np.where((gained < -0.5) & (height > 0.0), spent[active] + STEP, 0.0)
        active = active[~passed[active] & (spent[active] < HELD)]
    return gain, passed


LAWS = {f.__name__: f for f in (rest, slip, restitution, impulse, penetration, convergence, tumbling)}
