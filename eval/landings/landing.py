"""Simulates landings and says what became of each.

A landing starts in a given state over or at the slope and is watched for a fixed time at every engine
step. The motors stop at the first control tick at which the cut is due, thrust command and attitude
torque alike (the torques come from the motors too); the thrust decays with its lag.

Outcomes, in the order in which they are asked for:

- *misses*: the slab is never touched, or something else before it, or it is hit from beside;
- *rests*: at the end still, on the feet and nothing else, on the slab;
- *tips over*: tilted by more than 60 deg from the slope's normal while over the slab, or in the end on
  the slab on something else than its feet;
- *slides off*: over the slab's edge with the feet down, or still in motion with the feet down at the end;
- *bounces off*: over the edge through the air, or in the air at the end.

The feet are down when the lowest is less than 2 mm over the surface. Contact itself would be a poor
witness: a sliding vehicle chatters, and leaves the surface by a tenth of a millimetre over and over.
"""

from __future__ import annotations

import dataclasses
import math

import numba
import numpy as np

from inclined_landing.models.attitude import LAG, PITCH, VX, VZ, WY, X, Z
from inclined_landing.models.geometry import shapes_of
from inclined_landing.models.parameters import Vehicle, load_vehicle
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.scene import compile_scene

OUTCOMES = ("rests", "slides off", "bounces off", "tips over", "misses", "diverges")
RESTS, SLIDES, BOUNCES, TIPS, MISSES, DIVERGES = range(len(OUTCOMES))
# At rest: velocity and rate averaged over SMOOTHING stay below these. At restitutions above 0.35 the
# engine's contact spring chatters at some 30 Hz and 2 cm/s under a vehicle that goes nowhere.
REST_SPEED = 0.02  # m/s
REST_RATE = 0.2  # rad/s
SMOOTHING = 0.02  # s
TIPPED = math.cos(math.radians(60.0))
MEMORY = 0.1  # s, time constant of the running share of time with the feet down
HOP = 0.002  # m of the lowest foot over the surface that count as a flight
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
(TOUCH, TOUCH_NORMAL, TOUCH_ALONG, TOUCH_PITCH, SETTLED, DISTANCE, PEAK, IMPULSE, HOPS, TILT) = range(10)
# Further running values of one landing.
(SPOILT, LEFT, SHARE, LAST_MOVED, S0, Y0, AIR, FEET, OTHER, STILL, SPEED_N, SPEED_T, PITCH0, CLOCK) = range(
    10, 24
)
MEAN = 24  # and the five after it: averaged velocity and rates
BEFORE = 30  # step-averaged force of the step before
_SIZE = 31


@dataclasses.dataclass(frozen=True)
class Landings:
    """What became of n landings; columns of `values` are RESULTS."""

    outcome: np.ndarray  # (n,) int8, index into OUTCOMES
    values: np.ndarray  # (n, 10)


def feet_height(vehicle: Vehicle) -> float:
    """How far the model's feet reach below the centre of mass [m]."""
    shapes = shapes_of(compile_scene(vehicle))
    feet = shapes.parts == 0
    return float(-(shapes.centres[feet, 2] - shapes.radii[feet]).min())


def touchdown_states(p: dict[str, np.ndarray], vehicle: Vehicle) -> np.ndarray:
    """States (n, 13) just above the surface, from arrays (n,) of the study's parameters [SI].

    The lowest point is `start_height` above the surface; speeds are those of the centre of mass.
    """
    surface = -p["inclination"]  # rises towards +x
    n = len(surface)
    shapes = shapes_of(compile_scene(vehicle))
    # Heights of all points over the surface, vehicle pitched by the error, centre of mass on the surface.
    cos, sin = np.cos(p["attitude_error"])[:, None], np.sin(p["attitude_error"])[:, None]
    lower = np.where(shapes.parts == 0, (p["foot_height"] - feet_height(vehicle))[:, None], 0.0)
    lowest = (cos * (shapes.centres[:, 2] - lower) - sin * shapes.centres[:, 0] - shapes.radii).min(axis=1)
    height = p["start_height"] - lowest
    normal = np.stack([np.sin(surface), np.zeros(n), np.cos(surface)], axis=1)
    downhill = -np.stack([np.cos(surface), np.zeros(n), -np.sin(surface)], axis=1)
    state = np.zeros((n, 13))
    state[:, X : Z + 1] = height[:, None] * normal + p["offset"][:, None] * downhill
    state[:, Z] += vehicle.platform_surface_height
    state[:, VX : VZ + 1] = -p["normal_speed"][:, None] * normal + p["tangential_speed"][:, None] * downhill
    state[:, PITCH] = surface + p["attitude_error"]
    state[:, WY] = p["pitch_rate"]
    state[:, LAG] = held_pwm(p, vehicle) / vehicle.thrust_lag_rate
    return state


def held_pwm(p: dict[str, np.ndarray], vehicle: Vehicle) -> np.ndarray:
    """PWM (n,) whose steady thrust is the given share of the weight."""
    force = p["thrust"] * p["mass"] * vehicle.environment_gravity
    return np.clip(force / vehicle.thrust_per_pwm, 0.0, vehicle.command_pwm_range[1])


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
    plant = MujocoPlant(n, v, timestep=timestep, threads=threads)
    ids = np.arange(n)
    surface = -p["inclination"]
    plant.set_platform(ids, surface)
    _configure(plant, p, v)
    plant.reset(ids, states)
    torque = plant.batch.expand("actuator_forcerange")
    loops = [plant.model.actuator(name).id for name in ("roll", "pitch", "yaw_rate")]
    commands, warning = plant.batch.bind("ctrl"), plant.batch.warning
    pwm = held_pwm(p, v)
    hold = np.clip(surface / v.attitude_gain, -v.command_angle_limit, v.command_angle_limit)
    running = _begin(states, surface)
    feet = plant.shapes.parts == 0
    sizes = np.array(
        [
            *(v.slab_half_length, 0.5 * v.platform_depth, v.platform_surface_height),
            *(plant.shapes.centres[feet, 0].max(), plant.shapes.radii[feet][0]),
            *(v.environment_gravity, v.thrust_state_gain, v.thrust_direct_gain),
        ]
    )
    active = ids  # landings that are not decided yet
    first = {name: plant.batch.bind(name).copy() for name in ("qpos", "qvel", "act")}
    powered = np.ones(n, bool)
    for tick in range(round(duration / plant.control_period)):
        now = tick * plant.control_period
        reference = 0.0 if from_start else running[:, TOUCH]
        with np.errstate(invalid="ignore"):
            cut = powered & (now + 1e-9 >= reference + p["motor_cut_delay"])
        powered &= ~cut
        torque[np.ix_(cut, loops)] = 0.0
        commands[:, 0] = np.where(powered, pwm, 0.0)
        commands[:, 2] = np.where(powered, hold, 0.0)
        seen = plant.batch.rollout(plant.substeps, record=("sensordata", *first), ids=active)
        _watch(
            seen["sensordata"], seen["qpos"], seen["qvel"], seen["act"], first["qpos"], first["qvel"],
            first["act"], active, surface, p["foot_height"], p["mass"], commands[:, 0], sizes, timestep,
            running,
        )  # fmt: skip
        for name, values in first.items():
            values[active] = seen[name][:, -1]
        active = active[~_decided(running[active])]
        if not len(active):
            break
    diverged = warning[:, :, 1].any(axis=1) | ~np.isfinite(first["qpos"]).all(axis=1)
    return _judge(running, diverged)


def _configure(plant: MujocoPlant, p: dict[str, np.ndarray], vehicle: Vehicle) -> None:
    """Mass and contact of every vehicle.

    Fields are always expanded and derived constants always computed, so that a landing's bits do not
    depend on what the others of its batch vary.
    """
    ids = np.arange(plant.n)
    plant.batch.expand("body_mass")[:, plant.model.body("crazyflie").id] = p["mass"]
    plant.batch.set_const()
    spring = {}
    if np.isfinite(p["restitution"]).all():
        spring = {"restitution": p["restitution"], "contact_time": p["contact_time"]}
    plant.set_contact(ids, friction=p["friction"], foot_height=p["foot_height"], **spring)


def _begin(states: np.ndarray, surface: np.ndarray) -> np.ndarray:
    running = np.zeros((len(states), _SIZE))
    running[:, [TOUCH, TOUCH_NORMAL, TOUCH_ALONG, TOUCH_PITCH, LEFT, S0, Y0]] = np.nan
    normal, along = _split(states, surface)
    running[:, SPEED_N], running[:, SPEED_T] = normal, along
    running[:, PITCH0] = states[:, PITCH] - surface
    return running


def _split(states: np.ndarray, surface: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Speeds into the surface and downhill (n,) [m/s]."""
    sin, cos = np.sin(surface), np.cos(surface)
    vx, vz = states[:, VX], states[:, VZ]
    return -(sin * vx + cos * vz), -(cos * vx - sin * vz)


@numba.njit(cache=True)
def _watch(
    sensors, qpos, qvel, act, first_qpos, first_qvel, first_act, active, surface, reach, mass, pwm,
    sizes, dt, running,
):  # fmt: skip
    """Fold one control step of the active landings, (k, substeps, ...), into their running values.

    The sensors of a substep belong to the state at its beginning, which is the end of the one before.
    reach: foot heights (n,) [m]; sizes: half the slab's length and depth, height of its middle, half the
    distance of the feet, their radius [m]; gravity, and the thrust's two gains.
    """
    half_length, half_depth, height, foot, radius, gravity, state_gain, direct_gain = sizes
    for i in range(sensors.shape[0]):
        own = active[i]
        r = running[own]
        sin, cos = math.sin(surface[own]), math.cos(surface[own])
        for k in range(sensors.shape[1]):
            q = first_qpos[own] if k == 0 else qpos[i, k - 1]
            v = first_qvel[own] if k == 0 else qvel[i, k - 1]
            row = sensors[i, k]
            now = r[CLOCK]
            r[CLOCK] += dt
            if r[LEFT] >= 0.0:
                continue
            # Downhill, sideways and outward position over the slab; outward and downhill speed.
            s = -(cos * q[0] - sin * (q[2] - height))
            out = sin * q[0] + cos * (q[2] - height)
            into = -(sin * v[0] + cos * v[2])
            along = -(cos * v[0] - sin * v[2])
            over = abs(s) <= half_length and abs(q[1]) <= half_depth and out > -0.01
            feet, other, elsewhere = row[0] > 0.0, row[4] > 0.0 or row[8] > 0.0, False
            for geom in range(3, 15):
                elsewhere = elsewhere or row[4 * geom] > 0.0
            touching = feet or other
            fx, fz = row[1] + row[5] + row[9], row[3] + row[7] + row[11]
            force = sin * fx + cos * fz
            # The body's axes along the surface's normal; the last is the cosine of the tilt.
            ahead = sin * (1.0 - 2.0 * (q[5] ** 2 + q[6] ** 2)) + cos * 2.0 * (q[4] * q[6] - q[3] * q[5])
            left = sin * 2.0 * (q[4] * q[5] - q[3] * q[6]) + cos * 2.0 * (q[5] * q[6] + q[3] * q[4])
            up = sin * 2.0 * (q[4] * q[6] + q[3] * q[5]) + cos * (1.0 - 2.0 * (q[4] ** 2 + q[5] ** 2))
            lowest = out - foot * (abs(ahead) + abs(left)) - (reach[own] - radius) * up - radius
            # What pushed outwards on average over the step: change of momentum, weight and thrust taken off.
            w = qvel[i, k]
            lag = 0.5 * ((first_act[own, 0] if k == 0 else act[i, k - 1, 0]) + act[i, k, 0])
            gained = (sin * w[0] + cos * w[2] + into) / dt + gravity * cos
            mean = mass[own] * gained - (state_gain * lag + direct_gain * pwm[own]) * up
            before, r[BEFORE] = r[BEFORE], mean
            if not r[TOUCH] >= 0.0:
                if elsewhere or (touching and not over):
                    r[SPOILT] = 1.0
                if touching and r[SPOILT] == 0.0:
                    r[TOUCH] = now
                    r[TOUCH_NORMAL], r[TOUCH_ALONG], r[TOUCH_PITCH] = r[SPEED_N], r[SPEED_T], r[PITCH0]
                    r[S0], r[Y0] = s, q[1]
                    r[SHARE], r[LAST_MOVED] = 1.0, now
                    r[MEAN:BEFORE] = v
                    r[IMPULSE] = dt * before  # its later stages may have met the surface already
                r[SPEED_N], r[SPEED_T] = into, along
                # Planar attitude: enough before the touch, where roll and yaw are small.
                r[PITCH0] = (
                    math.atan2(2.0 * (q[3] * q[5] - q[4] * q[6]), 1.0 - 2.0 * (q[5] ** 2 + q[4] ** 2))
                    - surface[i]
                )
            if not r[TOUCH] >= 0.0:
                continue
            if not over:
                r[LEFT] = now
                continue
            down = lowest < HOP
            r[SHARE] += dt / MEMORY * ((1.0 if down else 0.0) - r[SHARE])
            r[PEAK] = max(r[PEAK], force, mean)
            if now - r[TOUCH] < IMPULSE_TIME - 1.5 * dt:
                r[IMPULSE] += dt * mean
            if touching:
                r[AIR] = 0.0
            elif not down and r[AIR] == 0.0:
                r[AIR] = 1.0
                r[HOPS] += 1.0
            r[TILT] = max(r[TILT], math.acos(min(1.0, max(-1.0, up))))
            for a in range(6):
                r[MEAN + a] += dt / SMOOTHING * (v[a] - r[MEAN + a])
            m = r[MEAN:BEFORE]
            speed = math.sqrt(m[0] ** 2 + m[1] ** 2 + m[2] ** 2)
            rate = math.sqrt(m[3] ** 2 + m[4] ** 2 + m[5] ** 2)
            still = speed < REST_SPEED and rate < REST_RATE and r[SHARE] > 0.5
            if not still:
                r[LAST_MOVED] = now + dt
            r[DISTANCE] = math.sqrt((s - r[S0]) ** 2 + (q[1] - r[Y0]) ** 2)
            r[FEET] += dt / SMOOTHING * ((1.0 if feet else 0.0) - r[FEET])
            r[OTHER] += dt / SMOOTHING * ((1.0 if other or elsewhere else 0.0) - r[OTHER])
            r[STILL] = 1.0 if still else 0.0


def _decided(running: np.ndarray) -> np.ndarray:
    """(n,) bool: over the edge, or something else touched before the slab. Nothing later counts."""
    return (running[:, LEFT] >= 0.0) | (running[:, SPOILT] > 0.0)


def _judge(running: np.ndarray, diverged: np.ndarray) -> Landings:
    r = running
    touched, left = r[:, TOUCH] >= 0.0, r[:, LEFT] >= 0.0
    on_feet = (r[:, FEET] > 0.5) & (r[:, OTHER] < 0.5)
    rests = touched & ~left & (r[:, STILL] > 0) & on_feet
    tipped = (np.cos(r[:, TILT]) < TIPPED) | (~left & (r[:, OTHER] > 0.5))
    outcome = np.select(
        [diverged, ~touched, rests, tipped, r[:, SHARE] > 0.5],
        [DIVERGES, MISSES, RESTS, TIPS, SLIDES],
        BOUNCES,
    ).astype(np.int8)
    values = r[:, : len(RESULTS)].copy()
    values[:, SETTLED] = np.where(outcome == RESTS, r[:, LAST_MOVED] - r[:, TOUCH], np.nan)
    values[~touched, DISTANCE:] = np.nan
    values[diverged] = np.nan
    return Landings(outcome, values)
