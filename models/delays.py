"""Delayed commands, and delayed or tilted measurements, of n vehicles, saved with the plant's state.

A command is held for one control period. During a substep its exact average over the substep, shifted by the
delay, is applied, which changes smoothly with the delay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from inclined_landing.models.attitude import LAG, ROLL, STATE_SIZE, YAW, tilted
from inclined_landing.models.compiled import kernel, unlocked
from inclined_landing.models.vehicle import Vehicle


class Delays:
    """Histories for the delays of the vehicles; none are kept for delays of 0.

    vehicles: one for all, or those that `assign` chooses from; it is the first one until then.
    period: that of the commands [s].
    After `reset` the past is as if the first command had always been given, and the vehicle had always
    been in its first state.
    """

    def __init__(self, n: int, vehicles: Sequence[Vehicle], period: float):
        self.period = period
        self._of_each = {
            "_command": np.array(
                [[v.effects_thrust_delay, *(v.effects_attitude_delay,) * 3] for v in vehicles]
            ),
            "_measured": np.array(
                [[v.effects_mocap_delay, attitude_age(v)] for v in vehicles]  # of position, of attitude
            ),
            "_tilt": np.array([v.effects_mocap_tilt for v in vehicles]),
        }
        rows = 1 if len(vehicles) == 1 else n  # else what holds for all
        self._command, self._measured, self._tilt = (x[[0] * rows] for x in self._of_each.values())
        longest, oldest = self._of_each["_command"].max(), self._of_each["_measured"].max()
        self.of_commands, self.of_measurement = bool(longest > 0.0), bool(oldest > 0.0)
        self._tilts = bool(self._of_each["_tilt"].any())
        depth = math.ceil(longest / self.period) + 1 if self.of_commands else 0
        self.commands = np.zeros((n, depth, 4))
        self.fresh = np.ones(n, bool)  # no command since the reset
        depth = math.floor(oldest / self.period) + 2 if self.of_measurement else 0
        self.states = np.zeros((n, depth, STATE_SIZE))
        self._out = np.zeros((n, 4))

    def assign(self, ids, choice: np.ndarray) -> None:
        """Copy the delays of the vehicles numbered `vehicles` (k,) to the vehicles `ids`."""
        for name, values in self._of_each.items():
            getattr(self, name)[ids] = values[choice]

    def arrays(self) -> dict[str, np.ndarray]:
        """Return everything that a replay needs."""
        return {"past_commands": self.commands, "past_states": self.states, "fresh": self.fresh}

    def reset(self, ids, state: np.ndarray) -> None:
        """Reset the histories of the vehicles `ids`, now in `state` (k, 13)."""
        self.fresh[ids] = True
        if self.of_measurement:
            self.states[ids] = np.asarray(state)[..., None, :]

    def push_commands(self, commands: np.ndarray, ids=slice(None)) -> None:
        """Record the commands (n, 4) of the control period that begins for the vehicles `ids`."""
        if self.of_commands:
            self.commands[ids, 1:] = self.commands[ids, :-1]
            self.commands[ids, 0] = commands[ids]
            self.commands[self.fresh] = commands[self.fresh, None]
        self.fresh[ids] = False

    def push_state(self, state: np.ndarray, ids=slice(None)) -> None:
        """Record the state (n, 13) at the end of a control period of the vehicles `ids`."""
        if self.of_measurement:
            self.states[ids, 1:] = self.states[ids, :-1]
            self.states[ids, 0] = state[ids]

    def acting(self, start: float, length: float) -> np.ndarray:
        """Return the delayed commands (n, 4), averaged over `length` [s], `start` [s] after the last push."""
        _average(self.commands, self._command, self.period, start, length, self._out)
        return self._out

    def measurement(self, state: np.ndarray) -> np.ndarray:
        """Return `state` (n, 13) delayed, with linear interpolation between control steps, and tilted."""
        if self.of_measurement:
            state = _late(self.states, self._measured, self.period, state)
        if self._tilts:
            attitude, state = state[:, ROLL : YAW + 1].copy(), state.copy()
            _tilt(attitude, self._tilt, state[:, ROLL : YAW + 1])
        return state


def attitude_age(vehicle: Vehicle) -> float:
    """Return how much older the measured attitude is than its time stamp [s]."""
    return max(0.0, vehicle.effects_mocap_delay + vehicle.effects_estimator_delay)


@kernel
def _late(states, delays, period, state):
    """Return the state (n, 13) `delays` [s] (n, 2) or (1, 2) ago, from past ones (n, depth, 13), newest
    first.

    The second delay is that of the attitude and its rates.
    """
    out = state.copy()
    for i in range(len(state)):
        for k in range(state.shape[1]):
            steps = delays[i if len(delays) > 1 else 0, int(ROLL <= k < LAG)] / period
            if steps > 0.0:
                whole = int(steps)
                later = states[i, whole, k]
                change = states[i, whole + 1, k] - later
                if ROLL <= k <= YAW:
                    change = (change + math.pi) % (2 * math.pi) - math.pi
                out[i, k] = later + (steps - whole) * change
    return out


@kernel
def _tilt(attitude, tilt, out):
    for i in range(len(attitude)):
        roll, pitch = tilt[i if len(tilt) > 1 else 0]
        if roll != 0.0 or pitch != 0.0:
            tilted(attitude[i : i + 1], roll, pitch, out[i : i + 1])


@kernel
def _average(commands, delays, period, start, length, out):
    n, depth, size = commands.shape
    for i in range(n):
        delay = delays[i if len(delays) > 1 else 0]
        late = False
        for column in range(size):
            out[i, column] = commands[i, 0, column]
            late |= delay[column] != 0.0
        if not late:
            continue
        for column in range(size):
            begin, total = start - delay[column], 0.0
            for back in range(depth):
                # This command was held from -back periods for one period; the oldest one for ever.
                held_from = -back * period if back < depth - 1 else -math.inf
                share = min(begin + length, (1 - back) * period) - max(begin, held_from)
                if share > 0.0:
                    total += share / length * commands[i, back, column]
            out[i, column] = total


@unlocked
def averages(command, dt, delay):
    """Return the mean (m - 1,) of a held command (m,) over each of the m - 1 steps, `delay` seconds late."""
    m = command.shape[0]
    mean = np.empty(m - 1)
    shift = delay / dt
    whole = int(np.floor(shift))
    part = shift - whole
    for k in range(m - 1):
        newer, older = max(0, k - whole), max(0, k - whole - 1)
        mean[k] = (1.0 - part) * command[newer] + part * command[older]
    return mean
