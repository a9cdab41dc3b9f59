"""Parameters of landing studies, and the start of a landing under them; SI inside, file units outside.

A new parameter needs an entry in `known_parameters` and its effect in `touchdown_states` or `configure`.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from inclined_landing.models import contact, surface
from inclined_landing.models.attitude import LAG, PITCH, VX, VZ, WY, X, Z
from inclined_landing.models.geometry import reach_below, shapes_of
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.scene import compile_scene
from inclined_landing.models.vehicle import Vehicle

# Units that a study file may use, as factors to SI.
UNITS = {
    "1": {"1": 1.0},
    "rad": {"deg": math.pi / 180.0, "rad": 1.0},
    "rad/s": {"deg/s": math.pi / 180.0, "rad/s": 1.0},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "m/s": {"m/s": 1.0},
    "s": {"s": 1.0, "ms": 1e-3},
    "kg": {"kg": 1.0, "g": 1e-3},
}


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A parameter of a study. Bounds and default are in SI units."""

    name: str
    label: str
    unit: str  # in reports and, unless it says otherwise, in study files
    low: float
    high: float
    default: float
    at_touchdown: bool = False  # part of the start state: unknown to studies that start from a policy

    @property
    def kind(self) -> str:
        """Return the SI unit."""
        return next(si for si, units in UNITS.items() if self.unit in units)

    @property
    def factor(self) -> float:
        """Return the factor from the report's unit to SI."""
        return UNITS[self.kind][self.unit]

    def title(self) -> str:
        """Return the axis label with unit."""
        return self.label if self.unit == "1" else f"{self.label} [{self.unit}]"


@functools.cache
def known_parameters(vehicle: Vehicle | None = None) -> dict[str, Parameter]:
    """Return the parameters by name, with the defaults of a vehicle (the shipped one).

    A default of NaN stands for the contact spring of the vehicle file.

    Signs are those of a slope seen from its foot: speeds and offsets are positive downhill, attitude
    errors and pitch rates positive towards level, so that the uphill feet touch first.
    """
    vehicle = vehicle or load_vehicle()
    feet = float(reach_below(shapes_of(compile_scene(vehicle)), part="feet"))
    degree = math.pi / 180.0
    entries = (
        Parameter("inclination", "inclination", "deg", 0.0, vehicle.platform_max_inclination,
                  abs(vehicle.platform_inclination), True),
        Parameter("friction", "friction coefficient", "1", 0.0, 5.0, vehicle.contact_friction),
        Parameter("restitution", "restitution", "1", *contact.RESTITUTION, math.nan),
        Parameter("contact_time", "contact time", "ms", *contact.CONTACT_TIME, math.nan),
        Parameter("normal_speed", "normal touchdown speed", "m/s", 0.0, 5.0, 0.5, True),
        Parameter("tangential_speed", "downhill touchdown speed", "m/s", -5.0, 5.0, 0.0, True),
        Parameter("attitude_error", "attitude error", "deg", -180 * degree, 180 * degree, 0.0, True),
        Parameter("pitch_rate", "pitch rate", "deg/s", -2000 * degree, 2000 * degree, 0.0, True),
        Parameter("foot_height", "foot height", "mm", 0.6 * feet, 3.0 * feet, feet),
        Parameter("mass", "mass", "g", 0.010, 0.100, vehicle.body_mass),
        Parameter("thrust", "thrust over weight at touchdown", "1", 0.0, 1.5, 1.0, True),
        Parameter("motor_cut_delay", "motor cut delay", "ms", 0.0, 2.0, 0.0),
        Parameter("offset", "downhill offset of the touchdown", "m", -2.0, 2.0, 0.0, True),
        Parameter("start_height", "height of the lowest point at the start", "mm", 0.0, 1.0, 0.001, True),
    )  # fmt: skip
    return {entry.name: entry for entry in entries}


def touchdown_states(p: dict[str, np.ndarray], vehicle: Vehicle) -> np.ndarray:
    """Return the states (n, 13) just above the surface, from arrays (n,) of the study's parameters [SI].

    The lowest point is `start_height` above the surface; speeds are those of the centre of mass.
    """
    slope, error = -p["inclination"], p["attitude_error"]  # the slope rises towards +x
    shapes = shapes_of(compile_scene(vehicle))
    lowered = p["foot_height"] - reach_below(shapes, part="feet")
    # Lowest point at `start_height` over the surface, velocities v = -v_n n + v_t t (normal n, downhill t).
    up = np.stack([-np.sin(error), np.zeros_like(error), np.cos(error)], axis=1)
    height = p["start_height"] + reach_below(shapes, up, lowered=lowered)
    normal, downhill = surface.normal_of(slope), surface.downhill_of(slope)
    state = np.zeros((len(slope), 13))
    state[:, X : Z + 1] = height[:, None] * normal + p["offset"][:, None] * downhill
    state[:, Z] += vehicle.platform_surface_height
    state[:, VX : VZ + 1] = -p["normal_speed"][:, None] * normal + p["tangential_speed"][:, None] * downhill
    state[:, PITCH] = slope + error
    state[:, WY] = p["pitch_rate"]
    state[:, LAG] = steady_pwm(p, vehicle) / vehicle.thrust_lag_rate
    return state


def steady_pwm(p: dict[str, np.ndarray], vehicle: Vehicle) -> np.ndarray:
    """Return the PWM (n,) at which the steady thrust is the given share of the weight."""
    # PWM = share m g / (thrust per PWM)
    force = p["thrust"] * p["mass"] * vehicle.environment_gravity
    return np.clip(force / vehicle.thrust_per_pwm, 0.0, vehicle.command_pwm_range[1])


def configure(plant: MujocoPlant, p: dict[str, np.ndarray]) -> None:
    """Set mass and contact of every vehicle.

    Fields are always expanded and derived constants always computed, so that the bits of a landing do not
    depend on the parameters of others in its batch.
    """
    plant.batch.expand("body_mass")[:, plant.model.body("crazyflie").id] = p["mass"]
    plant.batch.set_const()
    spring = {}
    if np.isfinite(p["restitution"]).all():
        spring = {"restitution": p["restitution"], "contact_time": p["contact_time"]}
    plant.set_contact(np.arange(plant.n), friction=p["friction"], foot_height=p["foot_height"], **spring)
