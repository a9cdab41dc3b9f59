"""Motion of platforms: constant velocity and a sum of waves, in closed form.

A platform's pose at a time t [s] is its pose at rest (`Plant.set_platform`) plus

    velocity t + sum over its waves of amplitude sin(frequency t + phase),

with the velocity along x, y and z, and waves in each of MODES: along the world's x, y, z [m], and as angles
[rad] added to roll, pitch (inclination) and yaw (azimuth) of the attitude Rz(yaw) Rx(roll) Ry(pitch).
Velocities and accelerations are its derivatives, so that nothing is integrated and any time can be evaluated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from inclined_landing.models.attitude import PITCH, ROLL, VX, WX, WY, WZ, body_rates, sine_cosine
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.compiled import inlined, kernel

MODES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
_LARGEST_ROLL = 1.2  # rad: the angles' chart ends at 90 deg


class Waves(NamedTuple):
    """The parameters of the motions of n platforms, with up to W waves per mode, for compiled functions."""

    velocity: np.ndarray  # (n, 3) m/s
    amplitude: np.ndarray  # (n, 6, W) m, rad
    frequency: np.ndarray  # (n, 6, W) rad/s
    phase: np.ndarray  # (n, 6, W) rad


class Motion:
    """Motions of n platforms with the parameters `waves`; modes in the order of MODES.

    Raises UserError for arrays of other shapes, numbers that are not finite, and rolls beyond 1.2 rad.
    """

    def __init__(self, velocity, amplitude, frequency, phase):
        given, arrays = Waves(velocity, amplitude, frequency, phase), []
        for name, value in given._asdict().items():
            try:
                array = np.array(value, float, order="C")
            except (TypeError, ValueError, OverflowError):
                raise UserError(f"a motion's {name} must be an array of numbers") from None
            if not np.isfinite(array).all():
                raise UserError(f"a motion's {name} contains NaN or infinity")
            arrays.append(array)
        self.waves = Waves(*arrays)
        sizes = self.waves.amplitude
        n, count = len(self), sizes.shape[-1] if sizes.ndim else 0
        for name, array in self.waves._asdict().items():
            shape = (n, 3) if name == "velocity" else (n, 6, count)
            if array.shape != shape:
                raise UserError(f"a motion's {name} must have shape {shape}, not {array.shape}")
        if (np.abs(sizes[:, 3]).sum(axis=1) > _LARGEST_ROLL).any():
            raise UserError(f"the waves together may roll a platform by at most {_LARGEST_ROLL} rad")

    @classmethod
    def still(cls, n: int, waves: int = 1) -> Motion:
        """Return the motions of n platforms that do not move."""
        return cls(np.zeros((n, 3)), *np.zeros((3, n, 6, waves)))

    @classmethod
    def unchecked(cls, *arrays: np.ndarray) -> Motion:
        """Return the motion of valid, unshared `arrays` in the order of `Waves`."""
        motion = cls.__new__(cls)
        motion.waves = Waves(*arrays)
        return motion

    def __len__(self) -> int:
        return len(self.waves.velocity) if self.waves.velocity.ndim else 0

    def __getitem__(self, ids) -> Motion:
        """Return copies of the motions of the platforms `ids`, an index array, a mask or a slice."""
        return Motion.unchecked(*(np.array(values[ids]) for values in self.waves))

    def __setitem__(self, ids, motion: Motion) -> None:
        """Set the motions of the platforms `ids` (k,), with any number of waves."""
        more = motion.waves.amplitude.shape[2] - self.waves.amplitude.shape[2]
        if more > 0:
            velocity, *others = self.waves
            self.waves = Waves(velocity, *(np.pad(x, ((0, 0), (0, 0), (0, more))) for x in others))
        _replace(np.arange(len(self))[ids], motion.waves, self.waves)

    def at(self, times) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return displacement, rate and acceleration (n, 6) in each mode at times (n,) or one number [s].

        Rates and accelerations of the angles are those of the Euler angles.
        """
        out = np.empty((len(self), 3, 6))
        _displacements(_times(times, len(self)), self.waves, out)
        return out[:, 0], out[:, 1], out[:, 2]

    def platforms(self, times, rest: np.ndarray) -> np.ndarray:
        """Return states (n, 12) of platforms at times (n,) or one number [s], columns as `Plant.platform`.

        rest (n, 12): the platforms' states where they do not move.
        """
        platform = np.array(rest, float)
        _platforms(_times(times, len(self)), rest, self.waves, platform)
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


@kernel
def _displacements(times, waves, out):
    for i in range(len(out)):
        displacement(i, times[i], waves, out[i])


@kernel
def _platforms(times, rest, waves, platform):
    now = np.empty((3, 6))
    for i in range(len(platform)):
        displacement(i, times[i], waves, now)
        write_state(now, rest[i], platform[i])


@inlined
def write_state(now, rest, out):
    """Write the state of a platform into `out` (12,), from its `displacement` now and its state at rest."""
    turning = False
    for k in range(3):
        out[k], out[VX + k], out[ROLL + k] = rest[k] + now[0, k], now[1, k], rest[ROLL + k] + now[0, 3 + k]
        turning |= now[1, 3 + k] != 0.0
    if turning:
        rates = body_rates(out[ROLL], out[PITCH], now[1, 3], now[1, 4], now[1, 5])
        out[WX], out[WY], out[WZ] = rates
    else:
        out[WX] = out[WY] = out[WZ] = 0.0
