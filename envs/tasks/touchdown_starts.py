"""Training starts of the touchdown: around the raised edge of the slab, and just above the slope.

Slopes and headings of the starts are drawn before. For moving platforms, states are generated relative to
platforms at their usual position and then moved with them.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.envs.tasks.base import Start, hover_states
from inclined_landing.envs.tasks.landing import START_CLEARANCE, InclinedLanding
from inclined_landing.models import surface
from inclined_landing.models.attitude import LAG, PITCH, ROLL, STATE_SIZE, VX, VZ, YAW, X, Y, Z
from inclined_landing.models.vehicle import Vehicle

# Just over the slope: these bounds times a number from 0 (at rest on the slope) to 1.
_HEIGHT = 0.25  # m over the height at rest
_TILT = 0.15  # rad to both sides of the attitude on the slope
_FALL = 0.8  # m/s into the surface
_SPEED = 0.5  # m/s along it, both ways
_THRUST = (0.3, 1.1)  # lag state as a share of hover
_ALONG = 0.25  # m to both sides of the centre, always
_ACROSS = 0.6  # of the slab's half depth to both sides, always, in space
# Around the raised edge, in half lengths of the slab towards it from the centre.
_ALONG_SLAB = (-1.0, 2.5)


def around_edge(task: InclinedLanding, rng: np.random.Generator, start: Start) -> np.ndarray:
    """Return states (k, 13) at rest around the raised edge, which has to be passed on the way to the slope.

    Half of them lie in the lowest quarter of the start box.
    """
    original, start = start, _at_standstill(start, task.vehicle)
    k, v = len(start), task.vehicle
    uphill = np.where(start.inclination > 0.0, -1.0, 1.0) * v.slab_half_length
    (*_, low), (*_, high) = task.start_box()
    positions = np.zeros((k, 3))
    todo = np.arange(k)
    found = dataclasses.replace(start, state=np.zeros((k, STATE_SIZE)), present=np.ones(k, bool))
    while len(todo):
        positions[todo, 0] = uphill[todo] * rng.uniform(*_ALONG_SLAB, len(todo))
        positions[todo, 2] = low + (high - low) * rng.random(len(todo)) ** 2
        found.state[todo] = _into_space(rng, hover_states(positions[todo], v), start[todo], v)
        todo = todo[task.start_clearance(found[todo]) < START_CLEARANCE]
    return _with_platforms(found.state, original, v)


def close(task: InclinedLanding, rng: np.random.Generator, start: Start, rest_height: float) -> np.ndarray:
    """Return moving states (k, 13) just above the slope; rest_height [m]: that of a vehicle on its feet."""
    original, start = start, _at_standstill(start, task.vehicle)
    inclination = start.inclination
    k, v = len(start), task.vehicle
    sin, cos = np.sin(inclination), np.cos(inclination)  # along (cos, -sin), normal (sin, cos)
    far = rng.random(k)  # 0: at rest on the feet, motors at idle
    along = rng.uniform(-_ALONG, _ALONG, k)
    height = rest_height + far * _HEIGHT
    speed = far * rng.uniform(-_SPEED, _SPEED, k)
    fall = far * rng.uniform(0.0, _FALL, k)
    state = np.zeros((k, STATE_SIZE))
    state[:, X] = along * cos + height * sin
    state[:, Z] = v.platform_surface_height - along * sin + height * cos
    state[:, VX] = speed * cos - fall * sin
    state[:, VZ] = -speed * sin - fall * cos
    state[:, PITCH] = inclination + far * rng.uniform(-_TILT, _TILT, k)
    state[:, LAG] = v.hover_lag * far * rng.uniform(*_THRUST, k)
    state = _into_space(rng, state, start, v)
    if start.azimuth is not None:
        roll, pitch = surface.attitude_at_rest(inclination, start.azimuth - state[:, YAW])
        state[:, ROLL] = roll + far * rng.uniform(-_TILT, _TILT, k)
        state[:, PITCH] += pitch - inclination
    return _with_platforms(state, original, v, moving=True)


def _into_space(rng: np.random.Generator, state: np.ndarray, start: Start, v: Vehicle) -> np.ndarray:
    """Return states (k, 13) of the plane, shifted across it and turned with the slopes and the headings of
    the starts. For planar tasks they are unchanged.
    """
    if start.azimuth is None:
        return state
    state, half = state.copy(), 0.5 * v.platform_depth
    state[:, Y] += rng.uniform(-_ACROSS * half, _ACROSS * half, len(state))
    state = surface.turned(state, start.azimuth)
    state[:, YAW] = start.state[:, YAW]
    return state


def _at_standstill(start: Start, v: Vehicle) -> Start:
    """Return the starts relative to platforms at their usual position, with their slopes at the start."""
    if start.motion is None:
        return start
    platform, state = start.platforms(v), start.state.copy()
    state[:, : Z + 1] -= platform[:, : Z + 1]
    state[:, Z] += v.platform_surface_height
    slope, azimuth = surface.slope_of(platform)
    return dataclasses.replace(start, state=state, inclination=slope, azimuth=azimuth, motion=None)


def _with_platforms(state: np.ndarray, start: Start, v: Vehicle, moving: bool = False) -> np.ndarray:
    """Return states (k, 13) over platforms at their usual position, moved to the platforms of the starts.

    moving: with the velocity of the platforms' centres.
    """
    if start.motion is None:
        return state
    platform = start.platforms(v)
    state[:, : Z + 1] += platform[:, : Z + 1]
    state[:, Z] -= v.platform_surface_height
    if moving:
        state[:, VX : VZ + 1] += platform[:, VX : VZ + 1]
    return state
