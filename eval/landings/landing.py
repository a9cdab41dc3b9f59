"""Simulation of landings and classification of their outcomes.

A landing starts in a given state above or at the slope and is followed at every engine step, for a fixed time
or until its outcome is certain: over the slab's edge, or motionless on the slab for `REST_TIME` without
motors. The motors stop at the first control tick at which the cut is due, thrust and attitude torque together
(the motors produce both); the thrust decays with its lag.

Outcomes, in the order of the tests:

- *misses*: the slab is never touched, or another surface is touched first, or the slab is hit from the side;
- *rests*: motionless at the end, on the feet and nothing else, on the slab;
- *tips over*: tilted by more than 60 deg from the slope's normal while over the slab, or at the end on the
  slab but not on its feet;
- *slides off*: over the slab's edge with the feet down, or still in motion with the feet down at the end;
- *bounces off*: over the edge through the air, or in the air at the end.

The feet are down when the lowest is less than 2 mm above the surface. Contact itself is not a criterion,
because a sliding vehicle chatters, and repeatedly leaves the surface by a tenth of a millimetre.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from inclined_landing.eval.landings.parameters import configure, steady_pwm
from inclined_landing.models.geometry import GEOM_SURFACE
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import SLAB, STILL_RATE, STILL_SPEED, Recorder, Touch
from inclined_landing.models.vehicle import Vehicle

OUTCOMES = ("rests", "slides off", "bounces off", "tips over", "misses", "diverges")
RESTS, SLIDES, BOUNCES, TIPS, MISSES, DIVERGES = range(len(OUTCOMES))
# At rest: velocity and rate averaged over SMOOTHING stay below the recorder's limits. At restitutions above
# 0.35 the engine's contact spring chatters at some 30 Hz and 2 cm/s under a vehicle that goes nowhere.
SMOOTHING = 0.02  # s
# A vehicle that has been at rest on the slab for so long without motors, and hardly creeps, stays there. One
# that bounces back by more than a third may creep under the engine's contact spring, and over an edge. All
# 12 000 landings of steep_landing have the outcome that they have with twice the time.
REST_TIME = 0.1  # s
REST_CREEP = 1e-3  # m/s, on average
REST_ROOM = 0.01  # m to the slab's edges
TIPPED_COSINE = math.cos(math.radians(60.0))
FEET_TIME = 0.1  # s, time constant of the running share of time with the feet down
HOP_HEIGHT = 0.002  # m of the lowest foot over the surface that count as a flight
IMPULSE_TIME = 0.1  # s after the first touch over which the impulse is taken

RESULTS = {
    "touchdown_time": "s, first touch of the slab",
    "touchdown_normal_speed": "m/s into the surface, last value free of contact",
    "touchdown_tangential_speed": "m/s along the surface, positive downhill",
    "touchdown_attitude_error": "rad, pitch minus the surface's",
    "settling_time": "s from the touch until still, for landings that rest",
    "slide_distance": "m along the surface from the touch to the rest or to the slab's edge",
    "peak_force": "N, normal, largest of the slab's sampled and step-averaged force",
    "impulse": "N s, normal, of the first 0.1 s of contact, from the change of momentum",
    "bounces": "flights of more than 2 mm after the touch",
    "largest_tilt": "rad, from the surface's normal, after the touch",
}


class LandingConstants(NamedTuple):
    """The constants of n landings."""

    surface: np.ndarray  # (n,) rad, inclination of the platform
    reach: np.ndarray  # (n,) m, of the feet below the centre of mass
    sensors: np.ndarray  # (5, 3) addresses of the contact sensors
    half_length: float  # m, of the slab
    half_depth: float  # m
    height: float  # m, of the slab's middle
    foot: float  # m, half the distance of the feet
    radius: float  # m, of a foot
    dt: float  # s


class RunningValues(NamedTuple):
    """Running values of n landings, arrays (n,), updated at every engine step; see RESULTS for the first."""

    touch: np.ndarray  # s; NaN until the slab is touched from above, before anything else
    distance: np.ndarray  # m
    peak: np.ndarray  # N
    impulse: np.ndarray  # N s
    hops: np.ndarray
    tilt: np.ndarray  # rad
    touched_elsewhere: np.ndarray  # bool: something else was touched first
    over_edge: np.ndarray  # s; NaN until then
    share: np.ndarray  # of the last FEET_TIME with the feet down
    last_moved: np.ndarray  # s, of a vehicle that is not still with its feet down
    last_fast: np.ndarray  # s, wherever it lies
    s_fast: np.ndarray  # m, where that was
    y_fast: np.ndarray
    creep: np.ndarray  # m, from there
    room: np.ndarray  # m, to the slab's edges
    s0: np.ndarray  # m, where it touched: downhill, sideways
    y0: np.ndarray
    air: np.ndarray  # bool: in a hop
    feet: np.ndarray  # smoothed contact of the feet, of anything else
    other: np.ndarray
    still: np.ndarray  # bool
    before: np.ndarray  # N, mean force of the step before
    mean: np.ndarray  # (n, 6) smoothed speeds and rates


class Landings(NamedTuple):
    """Outcomes and results of n landings; columns of `values` are RESULTS."""

    outcome: np.ndarray  # (n,) int8, index into OUTCOMES
    values: np.ndarray  # (n, 10)


def simulate(
    states: np.ndarray,
    p: dict[str, np.ndarray],
    *,
    from_start: bool = False,
    duration: float = 2.0,
    timestep: float = 0.004,
    vehicle: Vehicle | None = None,
    threads: int = 0,
) -> Landings:
    """Land n vehicles from `states` (n, 13) under parameters p, arrays (n,) [SI].

    from_start: the motor cut delay counts from the start instead of from the first touch.
    The result of a landing does not depend on the others, nor on the number of threads.
    """
    v = vehicle or load_vehicle()
    n = len(states)
    plant = MujocoPlant(n, v, timestep=timestep, threads=threads, torque_needs_motors=True)
    slope = -p["inclination"]
    plant.set_platform(np.arange(n), slope)
    configure(plant, p)
    recorder = Recorder(plant, states)
    constants, running = _constants(plant, p), _initial_values(n)
    pwm = steady_pwm(p, v)
    hold = np.clip(slope / v.attitude_gain, -v.command_angle_limit, v.command_angle_limit)
    commands, powered, cut = np.zeros((n, 4)), np.ones(n, bool), np.zeros(n)
    active = np.arange(n)  # landings that are not decided yet
    for tick in range(round(duration / plant.control_period)):
        now = tick * plant.control_period
        reference = 0.0 if from_start else running.touch
        with np.errstate(invalid="ignore"):
            powered &= ~(now + 1e-9 >= reference + p["motor_cut_delay"])
        cut[powered] = now + plant.control_period
        commands[:, 0] = np.where(powered, pwm, 0.0)
        commands[:, 2] = np.where(powered, hold, 0.0)
        _update_period(recorder.advance(commands, active), active, constants, running)
        # Over the edge, or something else touched before the slab: nothing later counts.
        ended = (running.over_edge >= 0.0) | running.touched_elsewhere
        ended |= _stays(running, now + plant.control_period, cut)
        active = active[~ended[active]]
        if not len(active):
            break
    return _classify(running, recorder.touch, slope, plant.diverged)


def _constants(plant: MujocoPlant, p: dict[str, np.ndarray]) -> LandingConstants:
    v, shapes = plant.vehicle, plant.shapes
    feet = shapes.parts == 0
    return LandingConstants(
        *(-p["inclination"], p["foot_height"], plant.contact_sensors),
        *(v.slab_half_length, 0.5 * v.platform_depth, v.platform_surface_height),
        *(float(shapes.centres[0, feet, 0].max()), float(shapes.radii[0, feet][0])),
        plant.model.opt.timestep,
    )


def _initial_values(n: int) -> RunningValues:
    running = {name: np.zeros(n) for name in RunningValues._fields}
    running |= {name: np.zeros(n, bool) for name in ("touched_elsewhere", "air", "still")}
    running |= {name: np.full(n, np.nan) for name in ("touch", "over_edge", "s0", "y0")}
    return RunningValues(**(running | {"mean": np.zeros((n, 6))}))


@numba.njit(cache=True)
def _update_period(steps, active, constants, running):
    """Update the running values of the active landings by one control period."""
    for i in range(len(active)):
        row = active[i]
        sin, cos = math.sin(constants.surface[row]), math.cos(constants.surface[row])
        for k in range(len(steps.time)):
            if running.over_edge[row] >= 0.0:
                break
            q, now = steps.qpos[i, k], steps.time[k]
            s, out = _over_slab(q, sin, cos, constants.height)
            over = abs(s) <= constants.half_length and abs(q[1]) <= constants.half_depth and out > -0.01
            feet, other, elsewhere, force = _contact(steps.sensors[i, k], constants.sensors, sin, cos)
            ahead, across, up = _body_axes_along_normal(q, sin, cos)
            mean = sin * steps.force[i, k, 0] + cos * steps.force[i, k, 2]
            before, running.before[row] = running.before[row], mean
            if not running.touch[row] >= 0.0:
                if elsewhere or ((feet or other) and not over):
                    running.touched_elsewhere[row] = True
                if not (feet or other) or running.touched_elsewhere[row]:
                    continue
                running.touch[row] = running.last_moved[row] = now
                running.s0[row], running.y0[row] = s, q[1]
                running.share[row] = 1.0
                running.mean[row] = steps.qvel[i, k]
                running.impulse[row] = (
                    constants.dt * before
                )  # its later stages may have met the surface already
            if not over:
                running.over_edge[row] = now
                continue
            lowest = out - constants.foot * (abs(ahead) + abs(across))
            lowest = lowest - (constants.reach[row] - constants.radius) * up - constants.radius
            _update_hops(running, row, lowest < HOP_HEIGHT, feet or other, constants.dt)
            running.peak[row] = max(running.peak[row], force, mean)
            if now - running.touch[row] < IMPULSE_TIME - 1.5 * constants.dt:
                running.impulse[row] += constants.dt * mean
            running.tilt[row] = max(running.tilt[row], math.acos(min(1.0, max(-1.0, up))))
            running.distance[row] = math.sqrt((s - running.s0[row]) ** 2 + (q[1] - running.y0[row]) ** 2)
            running.room[row] = min(constants.half_length - abs(s), constants.half_depth - abs(q[1]))
            _update_rest(running, row, s, q[1], steps.qvel[i, k], feet, other or elsewhere, now, constants.dt)


@numba.njit(cache=True)
def _over_slab(q, sin, cos, height):
    """Return the downhill and outward position over the slab [m]."""
    return -(cos * q[0] - sin * (q[2] - height)), sin * q[0] + cos * (q[2] - height)


@numba.njit(cache=True)
def _contact(row, sensors, sin, cos):
    """Return whether the feet, another part, or anything elsewhere is in contact; normal force."""
    feet, body, rotors = sensors[SLAB]
    elsewhere = False
    for geom in range(len(sensors)):
        for part in range(3):
            elsewhere = elsewhere or (GEOM_SURFACE[geom] > 0 and row[sensors[geom, part]] > 0.0)
    fx = row[feet + 1] + row[body + 1] + row[rotors + 1]
    fz = row[feet + 3] + row[body + 3] + row[rotors + 3]
    return row[feet] > 0.0, row[body] > 0.0 or row[rotors] > 0.0, elsewhere, sin * fx + cos * fz


@numba.njit(cache=True)
def _body_axes_along_normal(q, sin, cos):
    """Return the body's axes along the surface's normal; the last is the cosine of the tilt."""
    ahead = sin * (1.0 - 2.0 * (q[5] ** 2 + q[6] ** 2)) + cos * 2.0 * (q[4] * q[6] - q[3] * q[5])
    across = sin * 2.0 * (q[4] * q[5] - q[3] * q[6]) + cos * 2.0 * (q[5] * q[6] + q[3] * q[4])
    up = sin * 2.0 * (q[4] * q[6] + q[3] * q[5]) + cos * (1.0 - 2.0 * (q[4] ** 2 + q[5] ** 2))
    return ahead, across, up


@numba.njit(cache=True)
def _update_hops(running, row, down, touching, dt):
    """Update the running share of time with the feet down, and the count of hops between contacts."""
    running.share[row] += dt / FEET_TIME * ((1.0 if down else 0.0) - running.share[row])
    if touching:
        running.air[row] = False
    elif not down and not running.air[row]:
        running.air[row] = True
        running.hops[row] += 1.0


@numba.njit(cache=True)
def _update_rest(running, row, s, y, speeds, feet, other, now, dt):
    """Update the low-pass filtered motion and contact, whether the vehicle is at rest, and since when."""
    m = running.mean[row]
    for a in range(6):
        m[a] += dt / SMOOTHING * (speeds[a] - m[a])
    speed = math.sqrt(m[0] ** 2 + m[1] ** 2 + m[2] ** 2)
    rate = math.sqrt(m[3] ** 2 + m[4] ** 2 + m[5] ** 2)
    slow = speed < STILL_SPEED and rate < STILL_RATE
    if not slow:
        running.last_fast[row], running.s_fast[row], running.y_fast[row] = now + dt, s, y
    running.creep[row] = math.sqrt((s - running.s_fast[row]) ** 2 + (y - running.y_fast[row]) ** 2)
    running.still[row] = slow and running.share[row] > 0.5
    if not running.still[row]:
        running.last_moved[row] = now + dt
    running.feet[row] += dt / SMOOTHING * ((1.0 if feet else 0.0) - running.feet[row])
    running.other[row] += dt / SMOOTHING * ((1.0 if other else 0.0) - running.other[row])


@numba.njit(cache=True)
def _contact_state(touch, slope, out):
    """Compute normal and downhill speed [m/s] and attitude error [rad] at first contact; out (n, 3).

    Planar attitude: enough before the touch, where roll and yaw are small.
    """
    for i in range(len(slope)):
        sin, cos = math.sin(slope[i]), math.cos(slope[i])
        q, v = touch.qpos[i], touch.qvel[i]
        out[i, 0], out[i, 1] = -(sin * v[0] + cos * v[2]), -(cos * v[0] - sin * v[2])
        pitch = math.atan2(2.0 * (q[3] * q[5] - q[4] * q[6]), 1.0 - 2.0 * (q[5] ** 2 + q[4] ** 2))
        out[i, 2] = pitch - slope[i]


def _on_feet(r: RunningValues) -> np.ndarray:
    return (r.feet > 0.5) & (r.other < 0.5)


def _stays(r: RunningValues, now: float, cut: np.ndarray) -> np.ndarray:
    """Return (n,) bool: which vehicles are motionless on the slab, so that they will remain there.

    cut (n,) [s]: when their motors stopped.
    """
    on_feet, fallen = _on_feet(r) & r.still, (r.touch >= 0.0) & (r.other > 0.5)
    rested = now - np.maximum(np.where(fallen, r.last_fast, r.last_moved), cut) >= REST_TIME
    creeps = (r.creep > REST_CREEP * (now - r.last_fast)) | (r.room < REST_ROOM)
    return (on_feet | fallen) & rested & ~creeps


def _classify(r: RunningValues, touch: Touch, slope: np.ndarray, diverged: np.ndarray) -> Landings:
    touched, over_edge = r.touch >= 0.0, r.over_edge >= 0.0
    rests = touched & ~over_edge & r.still & _on_feet(r)
    tipped = (np.cos(r.tilt) < TIPPED_COSINE) | (~over_edge & (r.other > 0.5))
    outcome = np.select(
        [diverged, ~touched, rests, tipped, r.share > 0.5],
        [DIVERGES, MISSES, RESTS, TIPS, SLIDES],
        BOUNCES,
    ).astype(np.int8)
    first = np.empty((len(slope), 3))
    _contact_state(touch, slope, first)
    settled = np.where(outcome == RESTS, r.last_moved - r.touch, np.nan)
    values = np.column_stack([r.touch, first, settled, r.distance, r.peak, r.impulse, r.hops, r.tilt])
    values[~touched | diverged] = np.nan
    return Landings(outcome, values)
