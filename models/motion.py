"""Motion of platforms: constant velocity and a sum of waves, in closed form.

A platform's pose at a time t [s] is its pose at rest (`Plant.set_platform`) plus

    velocity t + sum over its waves of amplitude sin(frequency t + phase),

with the velocity along x, y and z, and waves in each of MODES: along the world's x, y, z [m], and as angles
[rad] added to roll, pitch (inclination) and yaw (azimuth) of the attitude Rz(yaw) Rx(roll) Ry(pitch).
Velocities and accelerations are its derivatives, so that nothing is integrated and any time can be evaluated.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from inclined_landing.models.attitude import PITCH, ROLL, VX, WX, WY, WZ, body_rates, sine_cosine
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.compiled import inlined, inner, kernel

MODES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
_LARGEST_ROLL = 1.2  # rad: the angles' chart ends at 90 deg


class Waves(NamedTuple):
    """The arrays of a `Motion` for the compiled functions, with the same shapes."""

    velocity: np.ndarray
    amplitude: np.ndarray
    frequency: np.ndarray
    phase: np.ndarray


@dataclasses.dataclass
class Motion:
    """Motions of n platforms, each with up to W waves per mode; modes in the order of MODES.

    Raises UserError for arrays of other shapes, numbers that are not finite, and rolls beyond 1.2 rad.
    """

    velocity: np.ndarray  # (n, 3) m/s
    amplitude: np.ndarray  # (n, 6, W) m, rad
    frequency: np.ndarray  # (n, 6, W) rad/s
    phase: np.ndarray  # (n, 6, W) rad

    def __post_init__(self):
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            try:
                array = np.array(value, float, order="C")
            except (TypeError, ValueError, OverflowError):
                raise UserError(f"a motion's {field.name} must be an array of numbers") from None
            if not np.isfinite(array).all():
                raise UserError(f"a motion's {field.name} contains NaN or infinity")
            setattr(self, field.name, array)
        n, waves = len(self), self.amplitude.shape[-1] if self.amplitude.ndim else 0
        shapes = {"velocity": (n, 3)} | dict.fromkeys(("amplitude", "frequency", "phase"), (n, 6, waves))
        for name, shape in shapes.items():
            if (found := getattr(self, name).shape) != shape:
                raise UserError(f"a motion's {name} must have shape {shape}, not {found}")
        if (np.abs(self.amplitude[:, 3]).sum(axis=1) > _LARGEST_ROLL).any():
            raise UserError(f"the waves together may roll a platform by at most {_LARGEST_ROLL} rad")

    @classmethod
    def still(cls, n: int, waves: int = 1) -> Motion:
        """Return the motions of n platforms that do not move."""
        return cls(np.zeros((n, 3)), *np.zeros((3, n, 6, waves)))

    @classmethod
    def unchecked(cls, *arrays: np.ndarray) -> Motion:
        """Return the motion of valid, unshared `arrays` in the order of the fields."""
        motion = cls.__new__(cls)
        motion.velocity, motion.amplitude, motion.frequency, motion.phase = arrays
        return motion

    def __len__(self) -> int:
        return len(self.velocity) if self.velocity.ndim else 0

    def __getitem__(self, ids) -> Motion:
        """Return copies of the motions of the platforms `ids`, an index array, a mask or a slice."""
        return Motion.unchecked(*(np.array(values[ids]) for values in self.arrays))

    def __setitem__(self, ids, motion: Motion) -> None:
        """Set the motions of the platforms `ids` (k,), with any number of waves."""
        here, there = self.amplitude.shape[2], motion.amplitude.shape[2]
        for name in ("amplitude", "frequency", "phase") if there > here else ():
            setattr(self, name, np.pad(getattr(self, name), ((0, 0), (0, 0), (0, there - here))))
        _replace(np.arange(len(self))[ids], motion.arrays, self.arrays)

    @property
    def arrays(self) -> Waves:
        """The arrays for the compiled functions."""
        return Waves(self.velocity, self.amplitude, self.frequency, self.phase)

    def at(self, times) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return displacement, rate and acceleration (n, 6) in each mode at times (n,) or one number [s].

        Rates and accelerations of the angles are those of the Euler angles.
        """
        out = np.empty((len(self), 3, 6))
        _displacements(_times(times, len(self)), self.arrays, out)
        return out[:, 0], out[:, 1], out[:, 2]

    def platforms(self, times, rest: np.ndarray) -> np.ndarray:
        """Return states (n, 12) of platforms at times (n,) or one number [s], columns as `Plant.platform`.

        rest (n, 12): the platforms' states where they do not move.
        """
        platform = np.array(rest, float)
        _platforms(_times(times, len(self)), rest, self.arrays, platform)
        return platform


def _times(times, n: int) -> np.ndarray:
    out = np.empty(n)
    out[:] = times
    return out


@kernel
def _replace(ids, new, waves):
    """Replace the motions of the platforms `ids` (k,) in `waves` by the k motions `new`."""
    count = new.amplitude.shape[2]
    for row in range(len(ids)):
        i = ids[row]
        for k in range(3):
            waves.velocity[i, k] = new.velocity[row, k]
        for mode in range(6):
            for k in range(waves.amplitude.shape[2]):
                given = k < count
                waves.amplitude[i, mode, k] = new.amplitude[row, mode, k] if given else 0.0
                waves.frequency[i, mode, k] = new.frequency[row, mode, k] if given else 0.0
                waves.phase[i, mode, k] = new.phase[row, mode, k] if given else 0.0


@inlined
def displacement(i, t, waves, out):
    """Write displacement, rate and acceleration of platform i at t [s] in each mode into `out` (3, 6)."""
    velocity, amplitude, frequency, phase = waves
    for mode in range(6):
        # x = v_0 t + sum A sin(w t + p), v = v_0 + sum A w cos(w t + p), a = -sum A w^2 sin(w t + p)
        x, v, a = 0.0, 0.0, 0.0
        if mode < 3:
            v = velocity[i, mode]
            x = v * t
        for k in range(amplitude.shape[2]):
            size = amplitude[i, mode, k]
            if size != 0.0:
                omega = frequency[i, mode, k]
                sine, cosine = sine_cosine(omega * t + phase[i, mode, k])
                along = size * sine
                x += along
                v += size * omega * cosine
                a -= omega * omega * along
        out[0, mode], out[1, mode], out[2, mode] = x, v, a


@inner
def rate(i, t, waves, out):
    """Write the rate alone, as in `displacement`, into `out` (6,)."""
    for mode in range(6):
        v = waves.velocity[i, mode] if mode < 3 else 0.0
        for k in range(waves.amplitude.shape[2]):
            size, omega = waves.amplitude[i, mode, k], waves.frequency[i, mode, k]
            if size != 0.0:
                v += size * omega * sine_cosine(omega * t + waves.phase[i, mode, k])[1]
        out[mode] = v


@inner
def acceleration(i, t, waves, out):
    """Write the acceleration alone, as in `displacement`, into `out` (6,)."""
    for mode in range(6):
        a = 0.0
        for k in range(waves.amplitude.shape[2]):
            size, omega = waves.amplitude[i, mode, k], waves.frequency[i, mode, k]
            if size != 0.0:
                a -= omega * omega * (size * sine_cosine(omega * t + waves.phase[i, mode, k])[0])
        out[mode] = a


@kernel
def _displacements(times, waves, out):
    for i in range(len(out)):
        displacement(i, times[i], waves, out[i])


@kernel
def _platforms(times, rest, waves, platform):
    now, place = np.empty((3, 6)), np.empty(6)
    for i in range(len(platform)):
        displacement(i, times[i], waves, now)
        for k in range(3):
            place[k], place[3 + k] = rest[i, k], rest[i, ROLL + k]
        write_state(now, place, platform[i])


@inlined
def write_state(now, place, out):
    """Write the state of a platform into `out` (12,), from its `displacement` now and its place at rest.

    place (6,): x, y, z, roll, pitch, yaw.
    """
    turning = False
    for k in range(3):
        out[k], out[VX + k], out[ROLL + k] = place[k] + now[0, k], now[1, k], place[3 + k] + now[0, 3 + k]
        turning |= now[1, 3 + k] != 0.0
    if turning:
        rates = body_rates(out[ROLL], out[PITCH], now[1, 3], now[1, 4], now[1, 5])
        out[WX], out[WY], out[WZ] = rates
    else:
        out[WX] = out[WY] = out[WZ] = 0.0
