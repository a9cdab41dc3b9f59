"""Contacts of the vehicles' parts, and the engine's sensors that report them."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np

from inclined_landing.models import geometry
from inclined_landing.models.compiled import inner, kernel


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
        """(n,) bool: whether any part touches slab or base."""
        return _met(self.touch, 0, 2)

    @property
    def platform_near(self) -> np.ndarray:
        """(n,) bool: whether any part is within the keep-out zone of slab or base, or touches them."""
        return _met(self.near, 0, 2)

    @property
    def floor(self) -> np.ndarray:
        """(n,) bool: whether any part touches the floor."""
        return _met(self.touch, 2, 3)


@kernel
def _met(flags, first, last):
    """Return (n,) bool: whether any part has a flag (n, 3, 3) for one of the surfaces first to last - 1."""
    out = np.empty(len(flags), np.bool_)
    for i in range(len(flags)):
        met = False
        for surface in range(first, last):
            for part in range(3):
                met |= flags[i, surface, part]
        out[i] = met
    return out


@inner
def _meets(row, addresses):
    """Return whether any contact sensor in `row` (s,) has found a contact."""
    for geom in range(addresses.shape[0]):
        for part in range(addresses.shape[1]):
            if row[addresses[geom, part]] > 0.0:
                return True
    return False


@kernel
def read_contacts(sensors, ids, addresses, zone, near, touch, force):
    """Reduce contact sensors (k, substeps, s) to the rows `ids` of (n, 3, 3) arrays, by the maximum over
    substeps.

    The forces on one part by the base's geoms are added as vectors.
    """
    for seen in range(len(ids)):
        i = ids[seen]
        near[i] = False
        touch[i] = False
        force[i] = 0.0
        for s in range(sensors.shape[1]):
            row = sensors[seen, s]
            if not _meets(row, addresses):
                continue
            for surface in range(3):
                for part in range(3):
                    found = False
                    x = y = z = 0.0
                    for geom in range(len(geometry.GEOM_SURFACE)):
                        k = addresses[geom, part]
                        if geometry.GEOM_SURFACE[geom] == surface and row[k] > 0.0:
                            found = True
                            x, y, z = x + row[k + 1], y + row[k + 2], z + row[k + 3]
                    if found:
                        near[i, surface, part] = True
                        size = math.sqrt(x * x + y * y + z * z)
                        force[i, surface, part] = max(force[i, surface, part], size)
                        if size > 0.0 or not zone:
                            touch[i, surface, part] = True


def contact_sensors(model: mujoco.MjModel) -> np.ndarray:
    """Return the addresses (5, 3) in `sensordata` for each of geometry.CONTACT_GEOMS and each part.

    At the address is the number of contacts found, followed by the net force (3,) [N] of the geom on the
    part.
    """
    return np.array(
        [
            [int(model.sensor(f"{part}_{geom}").adr[0]) for part in geometry.PARTS]
            for geom in geometry.CONTACT_GEOMS
        ]
    )
