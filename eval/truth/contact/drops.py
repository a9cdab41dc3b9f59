"""Unpowered vehicles at rest and dropped, recorded at every engine step, for all measurements."""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.models import surface
from inclined_landing.models.attitude import LAG, PWM, STATE_SIZE, VX, VZ, WX, WZ, Z
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import STEP, Recorder, fly, impulses
from inclined_landing.models.vehicle import Vehicle

DURATION = 0.12  # s of a drop
PHASES = 8  # drops of one kind, their touch spread evenly over one step


def unpowered(
    vehicle: Vehicle, n: int, inclination=None, step: float = STEP, moving: bool = False
) -> MujocoPlant:
    """Return a plant of n vehicles that is stepped at the engine's step, without attitude torques.

    inclination: that of platforms and vehicles (n,) [rad], whose feet then rest at the platforms' centres.
    """
    plant = MujocoPlant(
        n, vehicle, control_period=step, timestep=step, torque_needs_motors=True, moving=moving
    )
    if inclination is not None:
        inclination = np.broadcast_to(np.asarray(inclination, float), (n,))
        plant.set_platform(np.arange(n), inclination)
        state = np.zeros((n, STATE_SIZE))
        state[:, :3] = surface.normal_of(inclination) * plant.foot_height
        state[:, Z] += vehicle.platform_surface_height
        state[:, 7] = inclination
        plant.reset(np.arange(n), state)
    return plant


def advance(plant: MujocoPlant, duration: float) -> np.ndarray:
    """Return the states (steps + 1, n, 13) after `duration` [s] with motors off."""
    return fly(plant, np.zeros((round(duration / plant.control_period), plant.n, 4)))


def energy(state: np.ndarray, vehicle: Vehicle) -> np.ndarray:
    """Return the kinetic and potential energy [J] of states (..., 13), zero at the origin."""
    # E = 1/2 m v^2 + 1/2 w'J w + m g z
    v, w = state[..., VX : VZ + 1], state[..., WX : WZ + 1]
    motion = vehicle.body_mass * (v**2).sum(axis=-1) + (w**2 * np.array(vehicle.body_inertia)).sum(axis=-1)
    return 0.5 * motion + vehicle.body_mass * vehicle.environment_gravity * state[..., Z]


@dataclasses.dataclass
class Drops:
    """First touch of drops on the level slab, four feet at once; arrays (settings, PHASES)."""

    restitution: np.ndarray  # speed after over speed before; 0 where the vehicle stays down
    pushed: np.ndarray  # s that the surface pushed; NaN where the vehicle stays down
    depth: np.ndarray  # m, deepest penetration
    peak: np.ndarray  # N, largest force
    sampled: np.ndarray  # N s, sum of the sensors' forces up to the rebound or DURATION
    recorded: np.ndarray  # N s, that of the recorder's, from the change of momentum
    impulse: np.ndarray  # N s, of the contact forces in the engine's stages; NaN where not asked for


def drop(
    vehicle: Vehicle,
    speed: float,
    solrefs: np.ndarray | None = None,
    step: float = STEP,
    stages: bool = False,
    thrust: float = 0.0,
) -> Drops:
    """Drop level vehicles at `speed` [m/s] for each row of solrefs (k, 2); None is the default setting.

    stages: repeat the stages of every step to compute the contact impulse, which takes longer. thrust: the
    share of the weight that the rotors carry.
    """
    k = 1 if solrefs is None else len(solrefs)
    n = k * PHASES
    plant = unpowered(vehicle, n, 0.0, step)
    if solrefs is not None:
        plant.set_contact(np.arange(n), solref=np.repeat(solrefs, PHASES, axis=0))
    state = plant.state.copy()
    rest = state[:, Z].copy()
    state[:, Z] += speed * step * (1 + (np.arange(n) % PHASES + 0.5) / PHASES)
    state[:, VZ], state[:, LAG] = -speed, thrust * vehicle.hover_lag
    recorder = Recorder(plant, state)
    command = np.zeros((n, 4))
    command[:, PWM] = thrust * vehicle.hover_pwm
    lifted, up, pushed = np.zeros(n, bool), np.zeros(n), np.zeros(n)
    depth, peak, sampled, recorded = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    impulse = np.full(n, 0.0 if stages else np.nan)
    for _ in range(round(DURATION / step)):
        now = plant.state[:, VZ].copy()
        pushing = impulses(plant, command, np.flatnonzero(~lifted))[:, 2] if stages else np.nan
        mean = recorder.step(command).force[:, 0, 2]
        touch, force = plant.contacts.touch[:, 0].any(axis=1), plant.contacts.force[:, 0].sum(axis=1)
        leaves = recorder.touched & ~touch & ~lifted
        up[leaves] = now[leaves]
        lifted |= leaves
        pushed += step * ((force > 0) & ~lifted)
        sampled += step * np.where(lifted, 0, force)
        recorded += step * np.where(lifted, 0, mean)
        impulse += np.where(lifted, 0, pushing)
        depth = np.maximum(depth, np.where(lifted, 0, rest - plant.state[:, Z]))
        peak = np.maximum(peak, force)
        if lifted.all():  # a second touch is weaker
            break
    up[~lifted], pushed[~lifted] = 0.0, np.nan
    down, _ = recorder.touch_speeds()
    columns = (up / down, pushed, depth, peak, sampled, recorded, impulse)
    return Drops(*(column.reshape(k, PHASES) for column in columns))
