"""The parts that the plants share: options, contacts, scale of the thrust, snapshots."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from inclined_landing.models import forces, geometry
from inclined_landing.models.attitude import PITCH, STATE_SIZE, WZ, YAW, Z
from inclined_landing.models.attitude_loops import write_resting_integrals
from inclined_landing.models.base import schema
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.delays import Delays
from inclined_landing.models.disturbance import Disturbance, Seed
from inclined_landing.models.load import HANGING, LOAD_SIZE, UNLOADED, hanging
from inclined_landing.models.motion import Motion
from inclined_landing.models.parameters import as_vehicle, check_vehicle
from inclined_landing.models.plants.contacts import Contacts
from inclined_landing.models.scene import Period, Zone
from inclined_landing.models.vehicle import Vehicle

Attitude = Literal["rate_loop", "kinematic"]
Count = Annotated[int, Meta(ge=1, lt=2**31)]  # of vehicles
PLATFORM_SIZE = WZ + 1  # columns of a vehicle's state but for the lag
# What all vehicles of a plant have in common: another slab is another scene, other commands another task.
_SHARED = (
    *("slab_half_length", "platform_depth", "platform_thickness", "platform_max_inclination"),
    *("command_control_period", "command_pwm_range", "command_angle_limit", "command_yaw_rate_limit"),
)


def _differ(field: str, member: Vehicle, other: Vehicle) -> bool:
    """Return whether a field of two vehicles differs by more than rounding."""
    one, another = getattr(member, field), getattr(other, field)
    return one != another and not np.allclose(one, another, rtol=1e-9, atol=0.0)


_SIZE = ("rotor_arm", "rotor_height", "rotor_radius", "effects_foot_height")  # what shapes depend on


def sizes_differ(vehicles: Sequence[Vehicle]) -> bool:
    """Return whether any vehicle of one plant has a different shape than the first."""
    return any(_differ(field, member, vehicles[0]) for member in vehicles[1:] for field in _SIZE)


class Plant:
    """The base of all plants: platform poses, scale of the thrust, disturbance of the air, snapshots.

    pool: vehicles that `assign` can select instead of the plant's own vehicle, which all are initially. They
    share its platform and commands; their rotors and arms may differ.

    disturbance: seed of the vehicle file's disturbance, None for still air. It acts on every control period
    as acceleration and torque (`disturbance.py`); with kinematic attitude the torque has no effect.

    load (n, 6): directions of the slung loads from their vehicles and the directions' rates [1/s], in the
    world's axes; without rows if no vehicle of the plant has one. After a reset they hang straight down.

    integral (n, 2): time integrals of the errors of roll and pitch [rad s], for vehicles with integral gains,
    else 0; a reset sets them to 0.
    """

    def __init__(
        self,
        n: Count,
        vehicle: Vehicle | None,
        attitude: Attitude,
        keep_out: Zone,
        control_period: Period | None,
        disturbance: Seed | None,
        pool: Sequence[Vehicle] = (),
    ):
        options = {"n": n, "attitude": attitude, "keep_out": keep_out, "control_period": control_period}
        schema.check(options, schema.kinds_of(Plant.__init__))
        self.n = n
        self.shapes: geometry.Shapes  # of the plant's own vehicle, then of its pool if sizes differ
        self.vehicle = as_vehicle(vehicle)
        if isinstance(pool, str) or not isinstance(pool, Iterable):
            raise UserError(f"pool must be a list of vehicles, not {shown(repr(pool), 40)}")
        self.pool = tuple(pool)
        self._vehicles = (self.vehicle, *self.pool)
        for member in self._vehicles:
            check_vehicle(member)
        if differing := [f for member in self.pool for f in _SHARED if _differ(f, member, self.vehicle)]:
            table, _, entry = differing[0].partition("_")
            raise UserError(f"{table}.{entry} must be the same for all vehicles of one plant")
        self.attitude = attitude
        self.keep_out = keep_out
        self.control_period = control_period or self.vehicle.command_control_period
        self.state = np.zeros((n, STATE_SIZE))
        self.contacts = Contacts(np.zeros((n, 3, 3), bool), np.zeros((n, 3, 3), bool), np.zeros((n, 3, 3)))
        self.platform = np.zeros((n, PLATFORM_SIZE))  # the platforms' own states, see `set_platform`
        self.platform[:, Z], self.platform[:, PITCH] = (
            self.vehicle.platform_surface_height,
            self.vehicle.platform_inclination,
        )
        self.present = np.ones(n, bool)
        self.integral = np.zeros((n, 2))
        self.load = hanging(n) if any(v.effects_load_mass > 0.0 for v in self._vehicles) else UNLOADED
        self.thrust_scale = np.ones(n)  # factor on the total thrust, see `set_thrust_scale`
        self._everyone, self._alike = np.arange(n), np.zeros(n, int)
        # The vehicle whose constants each one has: 0 is the plant's, k the k-th of the pool.
        self.choice = np.zeros(n, int)
        self.delays = Delays(self.choice, self._vehicles, self.control_period)
        self._records = np.concatenate([forces.pack(member) for member in self._vehicles])
        self._hover_shares = np.array([v.hover_lag for v in self._vehicles]) / self.vehicle.hover_lag
        self._constants = self._records[self.choice] if self.pool else self._records  # (n,) or (1,)
        self._heights = np.array([v.platform_surface_height for v in self._vehicles])
        self._tilts = self._records["platform"]["inclination"] - self.vehicle.platform_inclination
        self.disturbance = None
        if disturbance is not None:
            self.disturbance = Disturbance(self.choice, self._vehicles, self.control_period, disturbance)

    def _arrays(self) -> dict[str, np.ndarray]:
        c = self.contacts
        return {
            "state": self.state,
            "near": c.near,
            "touch": c.touch,
            "force": c.force,
            "platform": self.platform,
            "present": self.present,
            "thrust_scale": self.thrust_scale,
            "integral": self.integral,
            **({"choice": self.choice} if self.pool else {}),
            **({"load": self.load} if len(self.load) else {}),
            **self.delays.arrays(),
            **(self.disturbance.arrays() if self.disturbance else {}),
        }

    def set_load(self, ids, direction, rate=0.0) -> None:
        """Set direction and rate of the slung loads of the vehicles `ids` (k,).

        direction: from the vehicle in the world's axes, (3,) or (k, 3), of any length. rate: its derivative
        [1/s]; the component along the direction is ignored. Raises UserError in a plant without loads and for
        a direction of length zero.
        """
        if not len(self.load):
            raise UserError("no vehicle of this plant has a slung load: effects.load_mass is 0")
        rows = np.zeros((len(self.load[ids]), LOAD_SIZE))
        rows[:, :3], rows[:, 3:] = direction, rate
        size = np.linalg.norm(rows[:, :3], axis=1, keepdims=True)
        if not (np.isfinite(rows).all() and (size > 0.0).all()):
            raise UserError("the direction of a slung load must be finite numbers, not all of them 0")
        rows[:, :3] /= size
        rows[:, 3:] -= (rows[:, :3] * rows[:, 3:]).sum(axis=1, keepdims=True) * rows[:, :3]
        self.load[ids] = rows

    @property
    def measurement(self) -> np.ndarray:
        """(n, 13): `state`, or its value one motion capture delay ago; do not change it."""
        return self.delays.measurement(self.state)

    def save(self) -> dict[str, np.ndarray]:
        """Return a snapshot: everything that a bit-for-bit replay needs, opaque to the caller."""
        return {name: array.copy() for name, array in self._arrays().items()}

    def restore(self, snapshot: dict[str, np.ndarray]) -> None:
        """Return to a snapshot of a plant of the same kind and size."""
        if set(self._arrays()) != set(snapshot) or self.n != len(snapshot["state"]):
            raise UserError("the snapshot belongs to a plant of a different kind or size")
        self._make_room(snapshot)
        for name, array in self._arrays().items():
            array[:] = snapshot[name]
        if self.disturbance:
            self.disturbance.resume()
        if self.pool:
            if not ((self.choice >= 0) & (self.choice <= len(self.pool))).all():
                raise UserError("the snapshot belongs to a plant with a different pool of vehicles")
            self._apply_choice(self._everyone)
        self._apply_thrust_scale()

    def _make_room(self, arrays: dict[str, np.ndarray]) -> None:
        """Hook for plants with arrays whose shapes may change."""

    def assign(self, ids, choice) -> None:
        """Replace the vehicles `ids` (k,) by those of the pool in `choice` (k,): 1 is the first, 0 the
        plant's own. Set their platform and state afterwards with `set_platform` and `reset`. Raises UserError
        if the pool has no such vehicle.
        """
        choice = np.asarray(choice, int)
        if not ((choice >= 0) & (choice <= len(self.pool))).all():
            raise UserError(f"choose vehicles 1 to {len(self.pool)} of the pool, or 0 for the plant's own")
        self.choice[ids] = choice
        self._apply_choice(self._everyone[ids])

    def _apply_choice(self, ids: np.ndarray) -> None:
        """Apply the `choice` of the vehicles `ids`."""
        # The records are copied as rows of numbers, because NumPy copies records field by field.
        forces.numbers(self._constants)[ids] = forces.numbers(self._records)[self.choice[ids]]

    @property
    def hover_share(self) -> np.ndarray:
        """Lag (n,) of each vehicle in hover over that of the plant's own."""
        return self._hover_shares[self.choice]

    @property
    def tilt(self) -> np.ndarray:
        """Angle (n,) by which each vehicle's platform is inclined more than the plant's own [rad]."""
        return self._tilts[self.choice]

    @property
    def inclination(self) -> np.ndarray:
        """Inclinations (n,) of the platforms [rad]."""
        return self.platform[:, PITCH]

    @property
    def azimuth(self) -> np.ndarray:
        """Angles (n,) by which the platforms are turned about the vertical [rad]."""
        return self.platform[:, YAW]

    def set_platform(self, ids, inclination, present=True, azimuth=0.0) -> None:
        """Set inclination [rad], presence and azimuth [rad] of the platforms of the vehicles `ids`.

        `platform` (n, 12) then contains their states, in the same columns as those of a vehicle: centre of
        the surface, velocity, attitude, rates. The surface's attitude is Rz(yaw) Rx(roll) Ry(pitch), its
        inclination the pitch. The platforms are at rest until `set_motion` is called.
        """
        height = self._heights[self.choice[ids]]
        rows = np.zeros((len(height), PLATFORM_SIZE))
        rows[:, Z], rows[:, PITCH], rows[:, YAW] = height, inclination, azimuth
        self.platform[ids] = rows
        self.present[ids] = present

    @property
    def motion(self) -> Motion | None:
        """The motion of the n platforms; None in a plant whose platforms cannot move."""
        return None

    def set_motion(self, ids, motion: Motion, time=0.0) -> None:
        """Set the motions of the platforms of the vehicles `ids` (k,), relative to their poses at rest.

        time: time of the motions [s] at the vehicles' `reset`, (k,) or a number. Raises UserError for
        plants made without `moving=True`.
        """
        raise UserError(
            "the platforms of this plant cannot move; make a mujoco or hybrid plant with moving=True"
        )

    def platform_at(self, times) -> np.ndarray:
        """Return `platform` (n, 12) at times (n,) or a number [s] since the vehicles' reset."""
        return self.platform.copy()

    def _platform_poses(self, ids) -> tuple[np.ndarray, np.ndarray]:
        """Return `geometry.platform_poses` for the vehicles `ids`."""
        where, height = (self.inclination[ids], self.present[ids]), self._heights[self.choice[ids]]
        return geometry.platform_poses(*where, self.vehicle, height, self.azimuth[ids])

    @property
    def size(self) -> np.ndarray:
        """Index (n,) of each vehicle in `shapes`."""
        return self._alike if self.shapes.are_equal else self.choice

    def clearance(self, ids: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Return `geometry.platform_clearances` (k,) [m] of the vehicles `ids`, in `state` (k, 13)."""
        where = self.platform[ids], self.present[ids], self.vehicle, self.shapes
        return geometry.platform_clearances(state, *where, self.size[ids])

    def set_thrust_scale(self, scale) -> None:
        """Multiply the total thrust of the vehicles by `scale`, (n,) or one for all.

        Raises UserError for a scale that is not finite.
        """
        if not np.isfinite(scale).all():
            raise UserError("the scale of the thrust must be finite")
        self.thrust_scale[:] = scale
        self._apply_thrust_scale()

    def _apply_thrust_scale(self) -> None:
        """Hook for plants that also store the scale of the thrust elsewhere."""

    def _begin(self, ids: np.ndarray, state: np.ndarray) -> None:
        """Begin a new episode of the vehicles `ids` at `state` (k, 13): the part common to all plants."""
        self.state[ids] = state
        write_resting_integrals(ids, self.state, self._constants, self.integral)
        if len(self.load):
            self.load[ids] = HANGING
        self.delays.reset(ids, state)
        if self.disturbance:
            self.disturbance.reset(ids)
        self._clear_contacts(ids)

    def _clear_contacts(self, ids) -> None:
        self.contacts.near[ids] = False
        self.contacts.touch[ids] = False
        self.contacts.force[ids] = 0.0
