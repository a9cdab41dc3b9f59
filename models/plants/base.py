"""What both plants share: options, contacts, perturbations, snapshots."""

from __future__ import annotations

import dataclasses
import math
from typing import Literal

import numpy as np

from inclined_landing.models import equations, perturbation
from inclined_landing.models.attitude import STATE_SIZE
from inclined_landing.models.delays import Delays
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle, check_vehicle, load_vehicle
from inclined_landing.models.unrest import Seed, Unrest

Attitude = Literal["rate_loop", "kinematic"]


@dataclasses.dataclass
class Contacts:
    """Contacts of the last control step; axes are vehicle, surface (slab, base, floor), part.

    Parts are feet, body, rotors. `near` includes a keep-out zone if the plant has one, `touch` does
    not. `force` is the largest net force on the part during the step [N]; NaN in the analytic plant,
    whose vehicles pass through surfaces.
    """

    near: np.ndarray  # (n, 3, 3) bool
    touch: np.ndarray  # (n, 3, 3) bool
    force: np.ndarray  # (n, 3, 3) N

    def __getitem__(self, ids) -> Contacts:
        """The contacts of the vehicles `ids`."""
        return Contacts(self.near[ids], self.touch[ids], self.force[ids])

    @property
    def platform(self) -> np.ndarray:
        """(n,) bool: any part touches slab or base."""
        return self.touch[:, :2].any(axis=(1, 2))

    @property
    def platform_near(self) -> np.ndarray:
        """(n,) bool: any part within the keep-out zone of slab or base, or touching."""
        return self.near[:, :2].any(axis=(1, 2))


@dataclasses.dataclass
class Snapshot:
    """Everything `Plant.restore` needs; opaque to the caller."""

    arrays: dict[str, np.ndarray]


class Plant:
    """What both plants share: platform poses, perturbations, unrest of the air, snapshots.

    unrest: seed of the vehicle file's unrest, None for still air. It acts on every control period as
    acceleration and torque (`unrest.py`); with kinematic attitude the torque has no effect.
    """

    def __init__(
        self,
        n: int,
        vehicle: Vehicle | None,
        attitude: Attitude,
        keep_out: float,
        control_period: float | None,
        unrest: Seed | None,
    ):
        if attitude not in ("rate_loop", "kinematic"):
            raise UserError(f"attitude must be 'rate_loop' or 'kinematic', not {attitude!r}")
        if n < 1:
            raise UserError(f"a plant needs at least one vehicle, not {n}")
        if not (math.isfinite(keep_out) and keep_out >= 0):
            raise UserError(f"keep_out must not be negative, it is {keep_out!r}")
        if control_period is not None and not (math.isfinite(control_period) and control_period > 0):
            raise UserError(f"control_period must be positive, not {control_period!r}")
        self.n = n
        self.vehicle = vehicle or load_vehicle()
        check_vehicle(self.vehicle)
        self.attitude = attitude
        self.keep_out = keep_out
        self.control_period = control_period or self.vehicle.command_control_period
        self.state = np.zeros((n, STATE_SIZE))
        self.contacts = Contacts(np.zeros((n, 3, 3), bool), np.zeros((n, 3, 3), bool), np.zeros((n, 3, 3)))
        self.inclination = np.full(n, self.vehicle.platform_inclination)
        self.present = np.ones(n, bool)
        self.perturbation = perturbation.neutral(n)
        self.delays = Delays(n, self.vehicle, self.control_period)
        self._constants = equations.pack(self.vehicle)
        self.unrest = None
        if unrest is not None:
            self.unrest = Unrest(n, self.vehicle, self.control_period, unrest)

    def _arrays(self) -> dict[str, np.ndarray]:
        c = self.contacts
        return {
            "state": self.state,
            "near": c.near,
            "touch": c.touch,
            "force": c.force,
            "inclination": self.inclination,
            "present": self.present,
            "perturbation": self.perturbation,
            **self.delays.arrays(),
            **(self.unrest.arrays() if self.unrest else {}),
        }

    @property
    def measurement(self) -> np.ndarray:
        """(n, 13): `state`, or what it was one motion capture delay ago; not to be changed."""
        return self.delays.measurement(self.state)

    def save(self) -> Snapshot:
        """Everything a later bit-for-bit replay needs."""
        return Snapshot({name: array.copy() for name, array in self._arrays().items()})

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot of a plant of the same kind and size."""
        own = self._arrays()
        if set(own) != set(snapshot.arrays) or self.n != len(snapshot.arrays["state"]):
            raise UserError("the snapshot belongs to a plant of another kind or size")
        for name, array in own.items():
            array[:] = snapshot.arrays[name]
        if self.unrest:
            self.unrest.resume()
        self._apply_perturbation()

    def perturb(self, **changes) -> None:
        """Set named deviations (see `perturbation.NAMES`) to a number or an (n,) array."""
        self.perturbation[:] = perturbation.perturb(self.perturbation, **changes)
        self._apply_perturbation()

    def _apply_perturbation(self) -> None:
        """Hook for plants that keep the perturbation elsewhere too."""

    def _begin(self, ids, state: np.ndarray) -> None:
        """Everything of a new episode of the vehicles `ids`, from `state` (k, 13), that both plants have."""
        self.state[ids] = state
        self.delays.reset(ids, state)
        if self.unrest:
            self.unrest.reset(ids)
        self._clear_contacts(ids)

    def _clear_contacts(self, ids) -> None:
        self.contacts.near[ids] = False
        self.contacts.touch[ids] = False
        self.contacts.force[ids] = 0.0
