"""Flights of one case side by side in a simulator by others.

`Batch` has what every such simulator needs: the pilot's filter and its limits, the faults at the interface
(`interface.py`), battery, motion capture and log. A simulator's own are a pilot, a flight controller and the
equations of motion (`rotorpy_reality.py`, `crazyflow_reality.py`). There is no ground effect: flights keep
clear of the floor.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence

import numpy as np

from tests.proof.simulator import KINDS, Build, Reality, Recording, World, constants, control, ordinary
from tests.proof.simulator.vehicle import PILOT_RATE

from . import interface
from .causes import Drawn
from .interface import RATE

WARM_UP = 2.0  # s flown before the log begins
LOWEST = 0.35  # m, of the references; a pilot without integral may be pressed down by a cause
_TOUCH, _FAR = 0.05, 4.0  # m, lowest and farthest centre of mass in a flight that counts
_TRIES = 10
_FILTER = (0.35, 0.06)  # alpha and beta of the pilot's filter of the position, every second period
# Columns of the state (n, 20) of a batch.
X, V, Q, W, WIND, ROTORS = (slice(*ends) for ends in ((0, 3), (3, 6), (6, 10), (10, 13), (13, 16), (16, 20)))


def draw_reality(rng: np.random.Generator, own: dict, family: str) -> Reality:
    """A vehicle with the constants `own`, in air and with a log that are drawn."""
    c = constants()._replace(
        **own,
        battery_voltage=rng.uniform(3.85, 4.15),
        position_noise=_between(rng, 0.0002, 0.003),
        attitude_noise=math.radians(_between(rng, 0.05, 0.5)),
    )
    b = Build(
        disturbance=tuple(_between(rng, 0.02, 0.15) for _ in range(3)),
        disturbance_time=_between(rng, 0.1, 1.0),
        disturbance_torque=tuple(_between(rng, 0.1, 1.0) * np.array([1.0, 1.0, 0.3])),
        log_ticks=float(rng.choice([2, 4, 6, 8, 10])),  # of 2 ms: 250 to 50 rows per second
    )
    return Reality(c, b, family)


def _between(rng, low: float, high: float) -> float:
    """Uniform on a logarithmic scale."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))


class Batch(abc.ABC):
    """Flights side by side: their state (n, 20) and their record, period by period."""

    def __init__(self, rows: np.ndarray, worlds: Sequence[World], rng, reality: Reality):
        self.rows, self.worlds, self.reality, n = rows, worlds, reality, len(worlds)
        c, b = reality.constants, reality.build
        self.w = w = World(*(np.array(column, float) for column in zip(*worlds)))
        ticks, level = len(rows) * RATE // PILOT_RATE, np.zeros(n)
        self.air, self.gust = interface.disturbance(rng, (ticks, n, 6), b), self.gusts(rng, ticks)
        scale = [c.position_noise] * 3 + [c.attitude_noise] * 3
        self.noise, self.heard = rng.standard_normal((ticks, n, 6)) * scale, interface.heard(rng, ticks, w)
        self.level = interface.turn(level, w.level_roll, w.level_pitch)
        self.crooked = interface.turn(level, w.mocap_roll, w.mocap_pitch)
        self.z = z = np.zeros((n, 20))
        z[:, X], z[:, Q] = rows[0, :, :3], interface.turn(rows[0, :, control.REF_YAW], level, level)
        self.states, self.commands = np.zeros((ticks, n, 20)), np.zeros((ticks, n, 4))
        self.volts = np.zeros((ticks, n))
        self.seen = np.zeros((ticks, n, 6))  # poses as motion capture shows them, without noise
        # What the pilot believes of position and velocity.
        self.position, self.velocity = rows[0, :, :3].copy(), np.zeros((n, 3))
        self.angles = np.zeros((n, 3))
        self.build()

    @abc.abstractmethod
    def build(self) -> None:
        """Make the vehicles and spin their rotors for hover."""

    def gusts(self, rng, ticks: int) -> np.ndarray:
        """Horizontal gusts (ticks, n, 3) of standard deviation `gust`."""
        path = interface.correlated(rng, (ticks, len(self.worlds), 3), self.w.gust_time)
        return path * self.w.gust[:, None] * [1.0, 1.0, 0.0]

    @abc.abstractmethod
    def wish(self, q: np.ndarray, ref: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The pilot's law, for attitudes q (n, 4) and one row of every reference (n, REF_SIZE).

        Returns thrust (n,) [N], attitude (n, 4), upward force (n,) [N].
        """

    @abc.abstractmethod
    def advance(self, estimate, wanted, supply, fade, push) -> np.ndarray:
        """The state one period later.

        estimate (n, 4) is the controller's attitude; wanted (n, 4) the thrust [N], roll, pitch and yaw rate
        that it received; supply (n,) the rotor speed per speed asked for; fade (n,) the share of thrust that
        is left; push (n, 6) what adds to acceleration and angular acceleration.
        """

    @abc.abstractmethod
    def thrusts(self, rotors: np.ndarray) -> np.ndarray:
        """Thrust [N] of rotors (..., 4) in still air."""

    def period(self, k: int) -> None:
        """One period of the flight controller."""
        c, w, z, time = self.reality.constants, self.w, self.z, k / RATE - WARM_UP
        self.states[k] = z
        estimate = interface.times(z[:, Q], self.level)  # of the flight controller
        self._see(k, z, estimate)
        if k % 2 == 0:
            self._track(interface.late(self.seen, k, w.mocap_delay) + self.noise[k], 2.0 / RATE)
        held, heard = RATE // PILOT_RATE, self.heard[k]
        self.commands[k] = self.commands[k - 1] if k % held else self._command(self.rows[k // held])
        pwm = interface.late(self.commands, heard, w.thrust_delay)[:, 0]
        rest = interface.received(interface.late(self.commands, heard, w.attitude_delay), w)
        wanted = np.column_stack([c.thrust_per_pwm * pwm, *rest])
        supply, fade = self._supply(k, z, time), 1.0 - w.thrust_fade * max(time, 0.0)
        z[:, WIND] = interface.wind(z[:, X], w) + self.gust[k]
        push = self.air[k].copy()
        push[:, :3] += interface.forces(z[:, Q], time, c, w)
        self.z = self.advance(estimate, wanted, supply, fade, push)

    def _see(self, k: int, z: np.ndarray, estimate: np.ndarray) -> None:
        """Fill row k of `seen`; its yaw is continuous."""
        seen = self.seen[k]
        seen[:, :3], seen[:, 3:] = z[:, X], interface.angles(interface.times(estimate, self.crooked))
        seen[:, 0] *= 1.0 + self.w.capture_scale * z[:, 0]
        seen[:, 5] += 2 * np.pi * np.round((self.seen[k - 1, :, 5] - seen[:, 5]) / (2 * np.pi))

    def _track(self, measured: np.ndarray, period: float) -> None:
        """Follow the measured poses (n, 6)."""
        self.position += self.velocity * period
        error = measured[:, :3] - self.position
        self.position += _FILTER[0] * error
        self.velocity += _FILTER[1] / period * error
        self.angles = measured[:, 3:]

    def _command(self, ref: np.ndarray) -> np.ndarray:
        """PWM, roll, pitch, yaw rate (n, 4) for one row of every reference (n, REF_SIZE)."""
        c, yaw = self.reality.constants, self.angles[:, 2]
        thrust, q, upward = self.wish(interface.turn(yaw, *self.angles[:, :2].T), ref)
        roll, pitch, _ = interface.angles(q).T
        step = ref[:, control.REF_MODE] == control.STEP  # angles as given, thrust for the height
        roll = np.where(step, ref[:, control.REF_ROLL], roll)
        pitch = np.where(step, ref[:, control.REF_PITCH], pitch)
        upright = upward / (np.cos(roll) * np.cos(pitch))
        pwm = np.where(step, upright, thrust) / c.thrust_per_pwm + ref[:, control.REF_PWM]
        off = np.angle(np.exp(1j * (ref[:, control.REF_YAW] - yaw)))
        turn = ref[:, control.REF_YAW_RATE] + c.yaw_gain * off
        most = np.array([c.angle_limit, c.angle_limit, c.yaw_rate_limit])
        rest = np.clip(np.column_stack([roll, pitch, turn]), -most, most)
        return np.column_stack([np.clip(pwm, *c.pwm_range), rest])

    def _supply(self, k: int, z: np.ndarray, time: float) -> np.ndarray:
        """Rotor speed (n,) per speed asked for, under the battery's voltage, which goes into the log."""
        c, w = self.reality.constants, self.w
        load = c.hover_current / (c.mass * c.gravity) * self.thrusts(z[:, ROTORS]).sum(1)
        self.volts[k] = c.battery_voltage + w.battery_voltage - c.battery_fall * max(time, 0.0)
        self.volts[k] -= w.battery_resistance * load
        share = self.volts[k] / np.where(w.battery_reference > 0.0, w.battery_reference, self.volts[k])
        return share ** (0.5 * self.reality.build.battery_power)

    def recordings(self, rng) -> list[Recording]:
        """The logs."""
        c, b, w = self.reality.constants, self.reality.build, self.w
        every, first = round(b.log_ticks) // 2, round(WARM_UP * RATE)
        rows = np.arange(-(-first // every) * every, len(self.states), every)
        delay = w.mocap_delay + w.log_delay
        poses = np.array([interface.late(self.seen, k, delay) for k in rows]) + self.noise[rows]
        flown = []
        for j in range(len(delay)):
            t, z = np.arange(len(rows)) * every / RATE, self.states[rows, j]
            late = b.stamp_jitter * rng.standard_normal(len(t))
            late = np.clip(late, -0.4 * every / RATE, 0.4 * every / RATE)
            rotors = self.thrusts(z[:, ROTORS])
            flown.append(
                Recording(
                    t=t + late - late[0],
                    position=poses[:, j, :3],
                    attitude=poses[:, j, 3:],
                    command=self.commands[rows, j],
                    voltage=self.volts[rows, j] + c.voltage_noise * rng.standard_normal(len(t)),
                    contact=np.zeros(len(t), bool),
                    truth=np.hstack([z[:, X], z[:, V], interface.angles(z[:, Q]), z[:, W], rotors]),
                )
            )
        return flown


def fly(
    simulator: type[Batch],
    paths: np.ndarray,
    worlds: Sequence[World],
    rng: np.random.Generator,
    reality: Reality,
) -> list[Recording]:
    """Fly paths (k, n, REF_SIZE) at 50 Hz, one in each world, and return their logs."""
    rows = np.concatenate([np.repeat(paths[:1], round(WARM_UP * PILOT_RATE), axis=0), paths])
    batch = simulator(rows, worlds, rng, reality)
    for k in range(len(batch.states)):
        batch.period(k)
    return batch.recordings(rng)


def fly_groups(
    simulator: type[Batch],
    groups: Sequence[tuple[Drawn, int]],
    rng: np.random.Generator,
    reality: Reality,
    seconds: float = 20.0,
) -> list[list[Recording]]:
    """Fly so many ordinary flights for every (cause, count), all in one batch; kinds in a random order.

    A flight that comes near the floor, or leaves the room, is flown again on another path.
    """
    todo = []  # kind, world, group
    for group, (drawn, count) in enumerate(groups):
        rounds = [rng.permutation(KINDS) for _ in range(-(-count // len(KINDS)))]
        for kind in np.concatenate(rounds)[:count] if count else ():
            fields = drawn.world | {field: rng.uniform(*ends) for field, ends in drawn.spread.items()}
            todo.append((str(kind), World(**fields), group))
    flown: dict[int, Recording] = {}
    for _ in range(_TRIES):
        left = [k for k in range(len(todo)) if k not in flown]
        if not left:
            return [[flown[k] for k in range(len(todo)) if todo[k][2] == g] for g in range(len(groups))]
        paths = [ordinary(todo[k][0], rng, seconds, LOWEST) for k in left]
        batch = fly(simulator, np.stack(paths, axis=1), [todo[k][1] for k in left], rng, reality)
        flown |= {k: one for k, one in zip(left, batch) if _stays(one)}
    raise RuntimeError(f"some flights of {reality.family} did not stay in the room")


def _stays(flight: Recording) -> bool:
    x = flight.truth[:, :3]
    return bool(np.isfinite(x).all() and x[:, 2].min() > _TOUCH and np.abs(x).max() < _FAR)
