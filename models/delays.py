"""Delayed commands, and delayed or tilted measurements, of n vehicles: plain histories, saved with the
plant's state.

A command is held for one control period. What acts during a substep is its exact average over the
substep, shifted by the delay: it changes smoothly with the delay.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from inclined_landing.models.attitude import PWM, ROLL, STATE_SIZE, YAW, tilted
from inclined_landing.models.parameters import Vehicle


class Delays:
    """The histories that a vehicle's delays need, and nothing for those that are 0.

    period: of the commands [s].
    After `reset` the past is as if the first command had always been given, and the vehicle had always
    been in its first state.
    """

    def __init__(self, n: int, vehicle: Vehicle, period: float):
        v = vehicle
        self.period = period
        self._command = np.full(4, v.effects_attitude_delay)
        self._command[PWM] = v.effects_thrust_delay
        self._mocap, self._tilt = v.effects_mocap_delay, v.effects_mocap_tilt
        self.of_commands = bool(self._command.any())
        self.of_measurement = self._mocap > 0.0
        longest = max(self._command)
        depth = math.ceil(longest / self.period) + 1 if self.of_commands else 0
        self.commands = np.zeros((n, depth, 4))
        self.fresh = np.ones(n, bool)  # no command since the reset
        depth = math.floor(self._mocap / self.period) + 2 if self.of_measurement else 0
        self.states = np.zeros((n, depth, STATE_SIZE))
        self._out = np.zeros((n, 4))

    def arrays(self) -> dict[str, np.ndarray]:
        """Everything that a replay needs."""
        return {"past_commands": self.commands, "past_states": self.states, "fresh": self.fresh}

    def reset(self, ids, state: np.ndarray) -> None:
        """Forget the past of the vehicles `ids`, now in `state` (k, 13)."""
        self.fresh[ids] = True
        if self.of_measurement:
            self.states[ids] = np.asarray(state)[..., None, :]

    def push_commands(self, commands: np.ndarray, ids=slice(None)) -> None:
        """Note the commands (n, 4) of the control period that begins for the vehicles `ids`."""
        if self.of_commands:
            self.commands[ids, 1:] = self.commands[ids, :-1]
            self.commands[ids, 0] = commands[ids]
            self.commands[self.fresh] = commands[self.fresh, None]
        self.fresh[ids] = False

    def push_state(self, state: np.ndarray, ids=slice(None)) -> None:
        """Note the state (n, 13) at the end of a control period of the vehicles `ids`."""
        if self.of_measurement:
            self.states[ids, 1:] = self.states[ids, :-1]
            self.states[ids, 0] = state[ids]

    def acting(self, start: float, length: float) -> np.ndarray:
        """Delayed commands (n, 4), averaged over `length` [s] from `start` [s] after the last push."""
        _average(self.commands, self._command, self.period, start, length, self._out)
        return self._out

    def measurement(self, state: np.ndarray) -> np.ndarray:
        """`state` (n, 13) as it was before the delay, interpolated linearly between control steps, tilted."""
        if any(self._tilt):
            state = self._late(state).copy()
            tilted(state[:, ROLL : YAW + 1].copy(), *self._tilt, state[:, ROLL : YAW + 1])
            return state
        return self._late(state)

    def _late(self, state: np.ndarray) -> np.ndarray:
        if not self.of_measurement:
            return state
        steps = self._mocap / self.period
        whole = math.floor(steps)
        later, earlier = self.states[:, whole], self.states[:, whole + 1]
        change = earlier - later
        angles = slice(ROLL, YAW + 1)
        change[:, angles] = (change[:, angles] + np.pi) % (2 * np.pi) - np.pi
        return later + (steps - whole) * change


@numba.njit(cache=True)
def _average(commands, delays, period, start, length, out):
    n, depth, size = commands.shape
    for column in range(size):
        begin = start - delays[column]
        for i in range(n):
            total = 0.0
            for back in range(depth):
                # This command was held from -back periods for one period; the oldest one for ever.
                held_from = -back * period if back < depth - 1 else -math.inf
                share = min(begin + length, (1 - back) * period) - max(begin, held_from)
                if share > 0.0:
                    total += share / length * commands[i, back, column]
            out[i, column] = total


@numba.njit(cache=True, nogil=True)
def averages(command, dt, delay):
    """Mean of a held command (m,) over each of the m - 1 steps, `delay` seconds late; (m - 1,)."""
    m = command.shape[0]
    mean = np.empty(m - 1)
    shift = delay / dt
    whole = int(np.floor(shift))
    part = shift - whole
    for k in range(m - 1):
        newer, older = max(0, k - whole), max(0, k - whole - 1)
        mean[k] = (1.0 - part) * command[newer] + part * command[older]
    return mean
