"""The paper's equations as a plant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta

from inclined_landing.models import equations, forces, geometry
from inclined_landing.models.base import schema
from inclined_landing.models.disturbance import Seed
from inclined_landing.models.plants.base import Attitude, Plant, sizes_differ
from inclined_landing.models.scene import Period, Zone, build_spec, compile_scene
from inclined_landing.models.vehicle import Vehicle


class AnalyticPlant(Plant):
    """The equations of `equations.py`; contact with obstacles is detected geometrically, without forces.

    substeps: RK4 steps per control period. The default of one is the paper's 0.02 s.
    disturbance: seed of the vehicle's disturbance of the air; None for still air.
    pool: vehicles that `assign` chooses from.
    """

    kind = "analytic"

    def __init__(
        self,
        n: int,
        vehicle: Vehicle | None = None,
        *,
        attitude: Attitude = "kinematic",
        keep_out: Zone = 0.0,
        control_period: Period | None = None,
        substeps: Annotated[int, Meta(ge=1, le=1000)] = 1,
        disturbance: Seed | None = None,
        pool: Sequence[Vehicle] = (),
    ):
        super().__init__(n, vehicle, attitude, keep_out, control_period, disturbance, pool)
        schema.check({"substeps": substeps}, schema.kinds_of(AnalyticPlant.__init__))
        self.substeps = substeps
        others = self.pool if sizes_differ(self._vehicles) else ()
        models = (build_spec(v, visuals=False, pooled=0.0).compile() for v in others)
        self.shapes = geometry.Shapes.of(
            [geometry.shapes_of(model) for model in (compile_scene(self.vehicle), *models)]
        )
        self._position, _ = geometry.platform_poses(self.inclination, self.present, self.vehicle)
        self._distance = np.empty((n, 3, 3))
        self._ambient = forces.free_air(n)
        self._ambient[:, forces.INCLINATION], self._ambient[:, forces.PRESENT] = self.inclination, True
        push = equations.STILL if self.disturbance is None else self.disturbance.held
        self._conditions = equations.Conditions(
            self._constants, self.thrust_scale, self._ambient, push, self.load, self.integral
        )
        self.reset(np.arange(n), self.state)

    def _arrays(self):
        return super()._arrays() | {"position": self._position, "ambient": self._ambient}

    def _clear_contacts(self, ids) -> None:
        super()._clear_contacts(ids)
        self.contacts.force[ids] = np.nan

    def set_platform(self, ids, inclination, present=True, azimuth=0.0) -> None:
        """See `Plant.set_platform`."""
        super().set_platform(ids, inclination, present, azimuth)
        self._position[ids], _ = self._platform_poses(ids)
        meets = forces.INCLINATION, forces.PRESENT, forces.AZIMUTH
        self._ambient[np.ix_(np.atleast_1d(ids), meets)] = np.stack(
            [self.inclination[ids], self.present[ids], self.azimuth[ids]], axis=1
        )

    def reset(self, ids, state: np.ndarray) -> None:
        """Put the vehicles `ids` into `state` (k, 13) at time 0; contacts and past commands cleared."""
        ids = self._everyone[ids]
        self._begin(ids, state)
        self._ambient[ids, forces.TIME] = 0.0

    def step(self, commands: np.ndarray, wanted: np.ndarray | None = None) -> None:
        """Advance every vehicle by one control period under commands (n, 4), regardless of `wanted`."""
        commands = np.array(commands, float, order="C")  # writable: one compiled kernel for all callers
        dt = self.control_period / self.substeps
        if self.disturbance is not None:
            self.disturbance.push(self.state, self.attitude == "rate_loop")
        self.delays.push_commands(commands, self._everyone)
        if self.delays.of_commands:
            for delayed in self.delays.acting(self.substeps):
                self._advance(delayed, dt, 1)
        else:
            self._advance(commands, dt, self.substeps)
        if self.disturbance:
            self.disturbance.step()
        self.delays.push_state(self.state, self._everyone)
        where = self.inclination, self._position, self.shapes
        within = float(self.keep_out)
        geometry.clearances(self.state, *where, self._distance, self.azimuth, self.size, within)
        np.less(self._distance, self.keep_out, out=self.contacts.near)
        np.less(self._distance, 0.0, out=self.contacts.touch)

    def _advance(self, commands: np.ndarray, dt: float, substeps: int) -> None:
        rate_loop = self.attitude == "rate_loop"
        equations.advance(self.state, commands, self._conditions, rate_loop, dt, substeps)
