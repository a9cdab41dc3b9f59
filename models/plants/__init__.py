"""Three plants with one interface for n vehicles: the paper's equations, MuJoCo, and a hybrid of both.

Everything above this module uses only this interface. A plant is stepped with the paper's commands
u = [PWM, roll, pitch, yaw rate] (n, 4) held for one control period (`control_period` [s]; the vehicle's
unless another is given), and provides

- `state` (n, 13): columns of `attitude.py`, a copy refreshed by every call;
- `measurement` (n, 13): the state as motion capture reports it, late if the vehicle has that delay;
- `contacts`: which surfaces the vehicles' parts touched during the last control step;
- `reset(ids, state)`: full state, lag included; `save()` / `restore()`: everything that a replay needs;
- `set_platform(ids, inclination, present, azimuth)` and `set_thrust_scale(scale)`, per vehicle.

With `pool=VEHICLES`, individual vehicles can differ from the plant's own: `assign(ids, choice)` selects them,
and they fly bit for bit as in a plant of their own.

With `disturbance=SEED` all vehicles are subject to the disturbance of the air in the vehicle file, which is
the same for the same seed (`disturbance.py`); otherwise the air is still.

The hybrid plant is the MuJoCo vehicle while a surface is within its reach, and flies by the equations
elsewhere: the same flights to 3.4e-5 m in 6 s, the same contacts, at a fraction of the time (`hybrid.py`).

With `moving=True` the platforms of these two move by `set_motion(ids, motion)` (`models/motion.py`). They
carry along vehicles that stand on them, and have no base. `platform` (n, 12) are the platforms' states in
every plant.

Both also have `set_contact(ids, ...)`: friction, restitution and contact time, foot height;
and `torque_needs_motors`: with it, a vehicle under PWM 0 has no attitude torque, because the motors produce
it. `recorder.Recorder` records touchdowns at every step of the engine.
"""

from __future__ import annotations

import inspect

from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.plants.analytic import AnalyticPlant
from inclined_landing.models.plants.base import Attitude, Plant
from inclined_landing.models.plants.contacts import Contacts
from inclined_landing.models.plants.hybrid import HybridPlant
from inclined_landing.models.plants.mujoco import MujocoPlant
from inclined_landing.models.vehicle import Vehicle

__all__ = [
    "PLANTS",
    "AnalyticPlant",
    "Attitude",
    "Contacts",
    "HybridPlant",
    "MujocoPlant",
    "Plant",
    "check_plant",
    "make_plant",
]

PLANTS = {"mujoco": MujocoPlant, "hybrid": HybridPlant, "analytic": AnalyticPlant}


def check_plant(kind: str) -> None:
    """Raise UserError unless `kind` is one of PLANTS."""
    if not isinstance(kind, str) or kind not in PLANTS:
        raise UserError(f"unknown plant {shown(repr(kind), 40)}; choose from {', '.join(PLANTS)}")


def make_plant(kind: str, n: int, vehicle: Vehicle | None = None, **options):
    """Return a plant by name, one of PLANTS; raises UserError for unknown options."""
    check_plant(kind)
    if kind == "analytic" and options.pop("moving", False):
        raise UserError("the analytic plant cannot move platforms; use the mujoco or hybrid plant")
    parameters = inspect.signature(PLANTS[kind]).parameters.values()
    known = [parameter.name for parameter in parameters if parameter.kind is parameter.KEYWORD_ONLY]
    for name in options:
        if name not in known:
            raise UserError(
                f"the {kind} plant has no option {shown(repr(name), 40)}; choose from {', '.join(known)}"
            )
    return PLANTS[kind](n, vehicle, **options)
