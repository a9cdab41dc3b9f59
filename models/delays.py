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

    choice (n,): which of `vehicles` each one is; later changes of this array count.
    period: that of the commands [s].
    After `reset` the past is as if the first command had always been given, and the vehicle had always
    been in its first state.
    """

    def __init__(self, choice: np.ndarray, vehicles: Sequence[Vehicle], period: float):
        n, self.period, self._choice = len(choice), period, choice
        self._command = np.array(
            [[v.effects_thrust_delay, *(v.effects_attitude_delay,) * 3] for v in vehicles]
        )
        delays = np.array([[v.effects_mocap_delay, v.effects_estimator_delay] for v in vehicles])
        self._measured = np.maximum(0.0, np.cumsum(delays, axis=1))  # of position, of attitude
        self._tilt = np.array([v.effects_mocap_tilt for v in vehicles])
        longest, oldest = self._command.max(), self._measured.max()
        self.of_commands, self.of_measurement = bool(longest > 0.0), bool(oldest > 0.0)
        self._of_state = self.of_measurement or bool(self._tilt.any())
        depth = math.ceil(longest / self.period) + 1 if self.of_commands else 0
        self.commands = np.zeros((n, depth, 4))
        self.fresh = np.ones(n, bool)  # no command since the reset
        depth = math.floor(oldest / self.period) + 2 if self.of_measurement else 0
        self.states = np.zeros((n, depth, STATE_SIZE))

    def arrays(self) -> dict[str, np.ndarray]:
        """Return everything that a replay needs."""
        return {"past_commands": self.commands, "past_states": self.states, "fresh": self.fresh}

    def reset(self, ids, state: np.ndarray) -> None:
        """Reset the histories of the vehicles `ids`, now in `state` (k, 13)."""
        self.fresh[ids] = True
        if self.of_measurement:
            self.states[ids] = np.asarray(state)[..., None, :]

    def push_commands(self, commands: np.ndarray, ids: np.ndarray) -> None:
        """Record the commands (n, 4) of the control period that begins for the vehicles `ids` (k,)."""
        if self.of_commands:
            fresh = ids[self.fresh[ids]]
            self.commands[fresh] = commands[fresh, None]
            _push(ids, commands, self.commands)
        self.fresh[ids] = False

    def push_state(self, state: np.ndarray, ids: np.ndarray) -> None:
        """Record the state (n, 13) at the end of a control period of the vehicles `ids` (k,)."""
        if self.of_measurement:
            _push(ids, state, self.states)

    def acting(self, steps: int) -> np.ndarray:
        """Return the delayed commands (steps, n, 4), averaged over each of the equal steps of a period."""
        out = np.empty((steps, *self.commands[:, 0].shape))
        _average(self.commands, self._command, self._choice, self.period, out)
        return out

    def measurement(self, state: np.ndarray) -> np.ndarray:
        """Return `state` (n, 13) delayed, with linear interpolation between control steps, and tilted."""
        if not self._of_state:
            return state
        return _measured(self.states, self._measured, self._tilt, self._choice, self.period, state)


@kernel
def _push(ids, now, past):
    """Prepend the rows `ids` of now (n, m) to their past ones (n, depth, m), and drop the oldest."""
    for i in ids:
        for back in range(past.shape[1] - 1, 0, -1):
            for k in range(past.shape[2]):
                past[i, back, k] = past[i, back - 1, k]
        for k in range(past.shape[2]):
            past[i, 0, k] = now[i, k]


@kernel
def _measured(states, delays, tilts, choice, period, state):
    """Return the state (n, 13) `delays` [s] ago, from past ones (n, depth, 13), newest first, and tilted.

    delays, tilts (m, 2): of each vehicle in `choice`. The second delay is that of the attitude and its rates.
    """
    out = state.copy()
    for i in range(len(state)):
        delay, tilt = delays[choice[i]], tilts[choice[i]]
        for k in range(state.shape[1]):
            steps = delay[int(ROLL <= k < LAG)] / period
            if steps > 0.0:
                whole = int(steps)
                later = states[i, whole, k]
                change = states[i, whole + 1, k] - later
                if ROLL <= k <= YAW:
                    change = (change + math.pi) % (2 * math.pi) - math.pi
                out[i, k] = later + (steps - whole) * change
        if tilt[0] != 0.0 or tilt[1] != 0.0:
            attitude = out[i : i + 1, ROLL : YAW + 1]
            tilted(attitude.copy(), tilt[0], tilt[1], attitude)
    return out


@kernel
def _average(commands, delays, choice, period, out):
    """Write the averages of past commands (n, depth, 4), newest first, over the steps of out (steps, n, 4).

    delays (m, 4): of each vehicle in `choice`.
    """
    n, depth, size = commands.shape
    length = period / len(out)
    for i in range(n):
        delay, late = delays[choice[i]], False
        for column in range(size):
            late |= delay[column] != 0.0
        for step in range(len(out)):
            for column in range(size):
                if not late:
                    out[step, i, column] = commands[i, 0, column]
                    continue
                begin, total = step * length - delay[column], 0.0
                for back in range(depth):
                    # This command was held from -back periods for one period; the oldest one for ever.
                    held_from = -back * period if back < depth - 1 else -math.inf
                    share = min(begin + length, (1 - back) * period) - max(begin, held_from)
                    if share > 0.0:
                        total += share / length * commands[i, back, column]
                out[step, i, column] = total


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
