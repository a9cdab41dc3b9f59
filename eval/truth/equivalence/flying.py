"""The same commands flown in both plants, far from every surface, and how far the flights differ."""

from __future__ import annotations

import numpy as np

from inclined_landing.eval.base.claims import Words
from inclined_landing.models.attitude import LAG, ROLL, YAW, Z
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import AnalyticPlant, Attitude, MujocoPlant
from inclined_landing.models.vehicle import Vehicle

WORDS = Words(__package__)  # of the report, with the tolerances
HEIGHT = 500.0  # m; full thrust up or none at all moves 6 s x up to 60 m/s
FINE = 20  # RK4 steps in a control period, 1 ms each: the equations solved to 1e-8 m
ATTITUDES: tuple[Attitude, ...] = ("kinematic", "rate_loop")


def engine(n: int, attitude: Attitude, vehicle: Vehicle | None = None, **options) -> MujocoPlant:
    """Return the MuJoCo vehicle without torque limit, which the equations do not have."""
    return MujocoPlant(n, vehicle, attitude=attitude, **({"torque_limit": False} | options))


def equations(
    n: int, attitude: Attitude, substeps: int = FINE, vehicle: Vehicle | None = None
) -> AnalyticPlant:
    """Return the paper's equations (kinematic), or those extended with the rate loop."""
    return AnalyticPlant(n, vehicle, attitude=attitude, substeps=substeps)


def start_states(n: int, yaw=0.0, vehicle: Vehicle | None = None) -> np.ndarray:
    """Return (n, 13) states in hover at HEIGHT, heading `yaw` (n,) [rad]."""
    state = np.zeros((n, 13))
    state[:, Z], state[:, YAW] = HEIGHT, yaw
    state[:, LAG] = (vehicle or load_vehicle()).hover_lag
    return state


def fly(plant, commands: np.ndarray, starts: np.ndarray | None = None, **changes) -> np.ndarray:
    """Return the states (steps, n, 13) after each of `commands` (steps, n, 4), without platform.

    starts: (n, 13), by default hovering; changes: perturbations (see `models.perturbation`).
    """
    everyone = np.arange(plant.n)
    plant.set_platform(everyone, plant.vehicle.platform_inclination, False)
    plant.reset(everyone, start_states(plant.n, vehicle=plant.vehicle) if starts is None else starts)
    if changes:
        plant.perturb(**changes)
    history = np.empty((len(commands), *plant.state.shape))
    for row, command in zip(history, commands):
        plant.step(command)
        row[:] = plant.state
    return history


def position_gap(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the distance [m] between states (..., 13)."""
    return np.linalg.norm(a[..., :3] - b[..., :3], axis=-1)


def angle_gap(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the largest difference of the three Euler angles [deg] between states (..., 13)."""
    turns = a[..., ROLL : YAW + 1] - b[..., ROLL : YAW + 1]
    return np.degrees(np.abs(np.arctan2(np.sin(turns), np.cos(turns))).max(axis=-1))


def largest_gaps(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Return (m, deg) largest differences between states (..., 13)."""
    return float(position_gap(a, b).max()), float(angle_gap(a, b).max())
